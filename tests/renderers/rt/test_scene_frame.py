"""SceneFrame: custom shaders next to the package's, over a scene that is edited; and GLSL roots."""

from __future__ import annotations

import numpy as np
import pytest
from support.frames import leaves_nothing

import solari_vk as sv
from solari_vk.bound import features
from solari_vk.bound.binder import SceneBinder
from solari_vk.gpu.shaders.compiler import CompilationError

SHADERS = {
    "mine": """
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
""",
    "masked": """
#include "scene/bindings.glsl"
#include "scene/ray_query.glsl"
layout(local_size_x = 1) in;
layout(set = 0, binding = 0) uniform accelerationStructureEXT tlas;
layout(set = 1, binding = 0, scalar) buffer AnswerBlock { float at[]; } answer;
void main() {
    const uint masks[] = uint[](SCENE_MASK, 0xFFu);
    RAY_QUERY(query);
    for (uint i = 0u; i < 2u; i++) {
        RayDesc desc = RayDesc(RAY_FLAG_NONE, masks[i], 0.0, 9.0, vec3(0.2, 0.2, 1.0), vec3(0.0, 0.0, -1.0));
        rayQueryInitialize(query, tlas, desc);
        while (rayQueryProceed(query)) { rayQueryConfirmIntersection(query); }
        answer.at[i] = rayQueryGetCommittedIntersection(query).t;
    }
}
""",
    "shiny": """
#include "scene/bindings.glsl"
layout(local_size_x = 1) in;
layout(set = 1, binding = 0, scalar) buffer AnswerBlock { uint at[]; } answer;
void main() { answer.at[0] = SCENE_SHINY ? 2u : 1u; }
""",
    "plain": "layout(local_size_x = 1) in;\nvoid main() {}\n",
}


def stage(*names):
    """A stage of some of SHADERS, with a buffer "answer"."""
    return sv.Stage("mine", buffers={"answer": 2}, passes=[sv.Pass(name, threads=1) for name in names])


def set_scale(folder, value):
    (folder / "mine").mkdir(exist_ok=True)
    (folder / "mine/scale.glsl").write_text(f"const float SCALE = {value};\n")


@pytest.fixture
def folder(tmp_path):
    """A GLSL root with SHADERS."""
    (tmp_path / "passes").mkdir()
    for name, text in SHADERS.items():
        (tmp_path / f"passes/{name}.comp").write_text(f"#version 460\n{text}")
    set_scale(tmp_path, 2.0)
    return tmp_path


@pytest.fixture
def factor(device):
    buffer = device.buffer(4, "factor")
    buffer.upload(np.float32(3))
    yield {"factor": buffer}
    buffer.destroy()


def triangle(z=0.0):
    return sv.Mesh(positions=np.array([[0, 0, z], [1, 0, z], [0, 1, z]], np.float32))


def submitted(frame):
    frame.submit()
    return frame["answer"]


def test_a_shader_sees_the_scene_and_its_edits(device, folder, factor):
    instance = sv.Instance(mesh=triangle(), material=sv.Material(base_color=(0.1, 0.2, 0.3)))
    scene = sv.Scene(instance)
    binder = SceneBinder(device, scene)
    with sv.SceneFrame(device, binder, [stage("mine")], external=factor, glsl_root=folder) as frame:
        assert submitted(frame)[0] == pytest.approx([0.6, 1.2, 1.8, 1])
        instance.material = sv.Material(base_color=(0.5, 0.5, 0.5))
        assert submitted(frame)[0] == pytest.approx([3, 3, 3, 1])
        instance.mesh = triangle(0.5)
        assert submitted(frame)[0] == pytest.approx([3, 3, 3, 0.5])
        for i in range(40):  # tables and TLAS are replaced by larger ones
            scene.add(sv.Instance(mesh=triangle(-1 - i), material=sv.Material()))
        assert submitted(frame)[0] == pytest.approx([3, 3, 3, 0.5])
        scene.remove(instance)
        frame.rebuild()
        frame.rebuild(external=factor)
        assert submitted(frame)[0, 3] == pytest.approx(2)
        frame.close()
    with sv.SceneFrame(device, binder, [stage("mine")], external=factor, glsl_root=folder) as other:
        assert submitted(other)[0, 3] == pytest.approx(2), "the binder is shared"
    binder.destroy()


def test_queries_with_the_scene_s_mask_pass_hidden_instances(device, folder):
    near, far = (sv.Instance(mesh=triangle(z), material=sv.Material()) for z in (0.0, -1.0))
    with sv.SceneFrame(device, sv.Scene(near, far), [stage("masked")], glsl_root=folder) as frame:
        assert submitted(frame).tolist() == [1, 1]
        near.visible = False
        assert submitted(frame).tolist() == [2, 1]


def test_roots_are_searched_in_order_and_their_changes_are_seen(device, folder, factor, tmp_path_factory):
    other = tmp_path_factory.mktemp("other")
    set_scale(other, 20.0)
    scene = sv.Scene(sv.Instance(mesh=triangle(), material=sv.Material(base_color=(0.1, 0.1, 0.1))))
    for roots, before, after in (([other, folder], 6.0, 6.0), ([folder, other], 0.6, 1.2), (str(folder), 0.6, 1.2)):
        set_scale(folder, 2.0)
        with sv.SceneFrame(device, scene, [stage("mine")], external=factor, glsl_root=roots) as frame:
            assert submitted(frame)[0, 0] == pytest.approx(before)
            set_scale(folder, 4.0)
            frame.rebuild()
            assert submitted(frame)[0, 0] == pytest.approx(after)


def test_errors_name_what_is_missing_and_leave_nothing(device, folder, factor):
    with leaves_nothing(device):
        with pytest.raises(sv.SolariError, match=r"there is no shader passes/none.comp in .*, .*glsl"):
            sv.SceneFrame(device, sv.Scene(), [stage("none")], glsl_root=folder)
        with pytest.raises(sv.SolariError, match=r"factor .* is used by mine, but no stage declares it"):
            sv.SceneFrame(device, sv.Scene(), [stage("mine")], glsl_root=folder)
        (folder / "mine/scale.glsl").unlink()
        with pytest.raises(CompilationError, match=r"mine/scale.glsl"):
            sv.SceneFrame(device, sv.Scene(), [stage("mine")], external=factor, glsl_root=folder)


def test_shaders_know_the_features_that_the_scene_has(device, folder, monkeypatch):
    row = features.Feature("SHINY", sv.Material, lambda material: material.metallic == 1)
    monkeypatch.setattr(features, "FEATURES", (*features.FEATURES, row))
    instance = sv.Instance(mesh=triangle())
    scene = sv.Scene(instance)
    binder = SceneBinder(device, scene)
    with sv.SceneFrame(device, binder, [stage("shiny", "plain")], glsl_root=folder) as frame:
        assert (submitted(frame)[0], binder.features) == (1, set())
        version = binder.bindings_version
        instance.material.metallic = 1.0
        assert (submitted(frame)[0], binder.features) == (2, {"SCENE_SHINY"})
        assert binder.bindings_version > version
        scene.remove(instance)
        assert submitted(frame)[0] == 2  # kept, so that objects that come and go don't compile pipelines anew
        with sv.SceneFrame(device, binder, [stage("shiny", "plain")], glsl_root=folder) as other:
            assert submitted(other)[0] == 2
    binder.destroy()
