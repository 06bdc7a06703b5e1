"""SceneFrame: custom shaders next to the package's, over a scene that is edited; and GLSL roots."""

from __future__ import annotations

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.bound import features
from solari_vk.bound.binder import SceneBinder
from solari_vk.gpu.shaders.compiler import CompilationError

SHADER = """#version 460
#include "scene/surface.glsl"
#include "scene/trace.glsl"
#include "mine/scale.glsl"
layout(local_size_x = 1) in;
layout(set = 1, binding = 0, scalar) buffer AnswerBlock { vec4 at[]; } answer;
layout(set = 1, binding = 1, scalar) readonly buffer FactorBlock { float at[]; } factor;
void main() {
    Hit hit = trace_closest_hit(vec3(0.2, 0.2, 1.0), 0.0, vec3(0.0, 0.0, -1.0), INFINITY, TRACE_BOTH_FACES);
    answer.at[0] = vec4(-1.0);
    if (hit.instance == NO_INDEX) { return; }
    vec3 color = materials.at[instances.at[hit.instance].material].base_color;
    answer.at[0] = vec4(SCALE * factor.at[0] * color, hit.t);
}
"""


@pytest.fixture
def folder(tmp_path):
    for name, text in (("passes/mine.comp", SHADER), ("mine/scale.glsl", "const float SCALE = 2.0;\n")):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    return tmp_path


@pytest.fixture
def factor(device):
    buffer = device.buffer(4, "factor")
    buffer.upload(np.float32(3))
    yield buffer
    buffer.destroy()


def triangle(z=0.0):
    return sv.Mesh(positions=np.array([[0, 0, z], [1, 0, z], [0, 1, z]], np.float32))


STAGE = sv.Stage("mine", buffers={"answer": 1}, passes=[sv.Pass("mine", threads=1)])


def test_a_shader_sees_the_scene_and_its_edits(device, folder, factor):
    instance = sv.Instance(mesh=triangle(), material=sv.Material(base_color=(0.1, 0.2, 0.3)))
    scene = sv.Scene(instance)

    def answer(frame):
        frame.submit()
        return pytest.approx(frame["answer"][0])

    with sv.SceneFrame(device, scene, [STAGE], external={"factor": factor}, glsl_root=folder) as frame:
        assert answer(frame) == [0.6, 1.2, 1.8, 1]
        instance.material = sv.Material(base_color=(0.5, 0.5, 0.5))
        assert answer(frame) == [3, 3, 3, 1]
        instance.mesh = triangle(0.5)
        assert answer(frame) == [3, 3, 3, 0.5]
        for i in range(40):  # tables and TLAS are replaced by larger ones
            scene.add(sv.Instance(mesh=triangle(-1 - i), material=sv.Material()))
        assert answer(frame) == [3, 3, 3, 0.5]
        scene.remove(instance)
        frame.rebuild()
        frame.rebuild(external={"factor": factor})
        frame.submit()
        assert frame["answer"][0, 3] == pytest.approx(2)


MASKED = """#version 460
#include "scene/bindings.glsl"
#include "scene/ray_query.glsl"
layout(local_size_x = 1) in;
layout(set = 0, binding = 0) uniform accelerationStructureEXT tlas;
layout(set = 1, binding = 0, scalar) buffer FoundBlock { float at[]; } found;
void main() {
    const uint masks[] = uint[](SCENE_MASK, 0xFFu);
    RAY_QUERY(query);
    for (uint i = 0u; i < 2u; i++) {
        RayDesc desc = RayDesc(RAY_FLAG_NONE, masks[i], 0.0, 9.0, vec3(0.2, 0.2, 1.0), vec3(0.0, 0.0, -1.0));
        rayQueryInitialize(query, tlas, desc);
        while (rayQueryProceed(query)) { rayQueryConfirmIntersection(query); }
        found.at[i] = rayQueryGetCommittedIntersection(query).t;
    }
}
"""


def test_queries_with_the_scene_s_mask_pass_hidden_instances(device, tmp_path):
    (tmp_path / "passes").mkdir()
    (tmp_path / "passes/masked.comp").write_text(MASKED)
    stage = sv.Stage("masked", buffers={"found": 2}, passes=[sv.Pass("masked", threads=1)])
    near, far = (sv.Instance(mesh=triangle(z), material=sv.Material()) for z in (0.0, -1.0))
    with sv.SceneFrame(device, sv.Scene(near, far), [stage], glsl_root=tmp_path) as frame:
        frame.submit()
        assert frame["found"].tolist() == [1, 1]
        near.visible = False
        frame.submit()
        assert frame["found"].tolist() == [2, 1]


def test_roots_are_searched_in_order_and_their_changes_are_seen(device, folder, factor, tmp_path_factory):
    other = tmp_path_factory.mktemp("other")
    (other / "mine").mkdir()
    (other / "mine/scale.glsl").write_text("const float SCALE = 20.0;\n")
    scene = sv.Scene(sv.Instance(mesh=triangle(), material=sv.Material(base_color=(0.1, 0.1, 0.1))))
    for roots, before, after in (([other, folder], 6.0, 6.0), ([folder, other], 0.6, 1.2), (str(folder), 0.6, 1.2)):
        with sv.SceneFrame(device, scene, [STAGE], external={"factor": factor}, glsl_root=roots) as frame:
            frame.submit()
            assert frame["answer"][0, 0] == pytest.approx(before)
            (folder / "mine/scale.glsl").write_text("const float SCALE = 4.0;\n")
            frame.rebuild()
            frame.submit()
            assert frame["answer"][0, 0] == pytest.approx(after)
        (folder / "mine/scale.glsl").write_text("const float SCALE = 2.0;\n")


def test_errors_name_what_is_missing_and_leave_nothing(device, folder, factor):
    device.wait_idle()
    scene, before = sv.Scene(), device.live_objects
    with pytest.raises(sv.SolariError, match=r"there is no shader passes/none.comp in .*, .*glsl"):
        sv.SceneFrame(device, scene, [sv.Stage("x", passes=[sv.Pass("none", 1)])], glsl_root=folder)
    with pytest.raises(sv.SolariError, match=r"factor .* is used by mine, but no stage declares it"):
        sv.SceneFrame(device, scene, [STAGE], glsl_root=folder)
    (folder / "mine/scale.glsl").unlink()
    with pytest.raises(CompilationError, match=r"mine/scale.glsl"):
        sv.SceneFrame(device, scene, [STAGE], external={"factor": factor}, glsl_root=folder)
    device.wait_idle()
    assert device.live_objects - before <= 4


def test_a_binder_is_shared(device, folder, factor):
    scene = sv.Scene(sv.Instance(mesh=triangle(), material=sv.Material()))
    binder = SceneBinder(device, scene)
    for _ in range(2):
        with sv.SceneFrame(device, binder, [STAGE], external={"factor": factor}, glsl_root=folder) as frame:
            frame.submit()
            assert frame["answer"][0, 3] == pytest.approx(1)
            frame.close()
    binder.destroy()


def test_shaders_know_the_features_that_the_scene_has(device, tmp_path, monkeypatch):
    row = features.Feature("SHINY", sv.Material, lambda material: material.metallic == 1)
    monkeypatch.setattr(features, "FEATURES", (*features.FEATURES, row))
    (tmp_path / "passes").mkdir()
    (tmp_path / "passes/shiny.comp").write_text(
        '#version 460\n#include "scene/bindings.glsl"\nlayout(local_size_x = 1) in;\n'
        "layout(set = 1, binding = 0, scalar) buffer ShinyBlock { uint at[]; } shiny;\n"
        "void main() { shiny.at[0] = SCENE_SHINY ? 2u : 1u; }\n"
    )
    (tmp_path / "passes/plain.comp").write_text("#version 460\nlayout(local_size_x = 1) in;\nvoid main() {}\n")
    stage = sv.Stage("shiny", buffers={"shiny": 1}, passes=[sv.Pass("shiny", threads=1), sv.Pass("plain", threads=1)])
    instance = sv.Instance(mesh=triangle())
    scene = sv.Scene(instance)
    binder = SceneBinder(device, scene)
    with sv.SceneFrame(device, binder, [stage], glsl_root=tmp_path) as frame:

        def seen():
            frame.submit()
            return int(frame["shiny"][0])

        assert (seen(), binder.features) == (1, set())
        version = binder.version
        instance.material.metallic = 1.0
        assert (seen(), binder.features) == (2, {"SCENE_SHINY"})
        assert binder.version > version
        scene.remove(instance)
        assert seen() == 2  # kept, so that objects that come and go don't compile pipelines again and again
        with sv.SceneFrame(device, binder, [stage], glsl_root=tmp_path) as other:
            other.submit()
            assert other["shiny"][0] == 2
    binder.destroy()
