"""Stages of a user's own inside the frames of renderers."""

import numpy as np
import pytest
from support.frames import make_renderer

import solari_vk as sv
from solari_vk.base.errors import CompilationError
from solari_vk.gpu.frame.frame import Draw, DrawList, History
from solari_vk.renderers.own_stages import OwnStages

SIZE = (24, 16)
HEAD = """#version 460
#extension GL_EXT_scalar_block_layout : require
layout(local_size_x = 8, local_size_y = 8) in;
"""
# Normals whose sign is dropped, plus what the previous frame had, times a uniform.
SHADERS = {
    "turn": """#include "passes/guides/bindings.glsl"
layout(set = 1, rgba16f) uniform image2D turned;
layout(set = 1, rgba16f) uniform readonly image2D previous_turned;
layout(set = 1, scalar) uniform TurnBlock { float factor; float kept; } turn;
void main() {
    ivec2 at = ivec2(gl_GlobalInvocationID.xy);
    if (any(greaterThanEqual(at, imageSize(turned)))) { return; }
    vec4 before = turn.kept * imageLoad(previous_turned, at);
    imageStore(turned, at, turn.factor * abs(imageLoad(guides_normal_roughness, at)) + before);
}""",
    "count": """layout(set = 1, rgba16f) uniform image2D turned;
layout(set = 1, scalar) buffer CountedBlock { uint at[]; } counted;
void main() {
    ivec2 at = ivec2(gl_GlobalInvocationID.xy), size = imageSize(turned);
    if (any(greaterThanEqual(at, size))) { return; }
    counted.at[at.y * size.x + at.x] = uint(imageLoad(turned, at).x > 0.5);
}""",
    "dim": """#include "passes/bindings.glsl"
void main() {
    ivec2 at = ivec2(gl_GlobalInvocationID.xy);
    if (at.x < 24 && at.y < 16) { radiance.at[at.y * 24 + at.x] *= 0.5; }
}""",
    "mean": """layout(set = 1, scalar) buffer RadianceMeanBlock { vec3 at[]; } radiance_mean;
layout(set = 1, scalar) buffer GreenBlock { float at[]; } green;
void main() {
    uint index = gl_GlobalInvocationID.y * 24 + gl_GlobalInvocationID.x;
    if (index < 24 * 16) { green.at[index] = radiance_mean.at[index].y; }
}""",
    "names": """layout(set = 1, r32f) uniform image2D pixel;
layout(set = 1, r32f) uniform image2D small;
layout(set = 1, scalar) buffer SizeBlock { uint at[]; } size;
layout(set = 1, scalar) buffer PcgBlock { uvec2 at[]; } pcg;
void main() {
    uvec2 at = gl_GlobalInvocationID.xy;
    if (at.x >= 24 || at.y >= 16) { return; }
    imageStore(pixel, ivec2(at), vec4(0.5));
    imageStore(small, ivec2(at), vec4(0.5));
    size.at[at.y * 24 + at.x] = 3u;
    pcg.at[at.y * 24 + at.x] = uvec2(3u);
}""",
    "fill": """layout(set = 1, scalar) buffer HistogramBlock { uint at[]; } histogram;
void main() { histogram.at[gl_GlobalInvocationID.x] = 7u; }""",
    "triangle": """struct Command { uint vertices; uint instances; uint first_vertex; uint first_instance; };
layout(set = 1, scalar) buffer CommandsBlock { Command at[]; } commands;
layout(set = 1, scalar) buffer CommandCountBlock { uint at[1]; } command_count;
layout(set = 1, r32f) uniform image2D drawn;
void main() {
    if (imageSize(drawn).x > 0) { commands.at[0] = Command(3u, 1u, 0u, 0u); command_count.at[0] = 1u; }
}""",
    "broken": "void main() { missing(); }",
    "orphan": "layout(set = 1, r8) uniform image2D nobody;\nvoid main() { imageStore(nobody, ivec2(0), vec4(0)); }",
}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "passes").mkdir()
    for name, text in SHADERS.items():
        (tmp_path / "passes" / f"{name}.comp").write_text(HEAD + text)
    return tmp_path


@pytest.fixture
def turn(folder):
    def make(size, name="turn"):
        passes = [sv.Pass("turn", threads=size)]
        return sv.Stage(name, images={"turned": History(size)}, passes=passes, glsl_root=folder)

    return make


@pytest.fixture
def count(folder):
    def make(size):
        pixels = size[0] * size[1]
        return sv.Stage(
            "count", buffers={"counted": pixels}, passes=[sv.Pass("count", threads=size)], glsl_root=str(folder)
        )

    return make


def turned_normals(frame):
    return np.abs(frame["guides_normal_roughness"].astype(np.float32))


def test_an_empty_stage_changes_no_bit(device):
    scene = sv.builtin("cornell_box")
    for kind, after, options in ((sv.Renderer, "guides", {}), (sv.PathTracer, "reference", {"samples": 3})):
        with kind(device, scene, SIZE) as plain, kind(device, scene, SIZE) as renderer:
            for number in range(3):
                if number == 1:  # a realtime frame has a history then
                    renderer.add_stage(sv.Stage("nothing"), after=after)
                expected, frame = plain.render(**options), renderer.render(**options)
            assert frame.keys() == expected.keys()
            different = [
                name for name in frame if name != "error" and frame[name].tobytes() != expected[name].tobytes()
            ]
            assert not different


def test_outputs_views_and_the_life_of_a_stage(device, turn, count):
    scene = sv.builtin("cornell_box")
    with sv.Renderer(device, scene, SIZE, sv.Settings(jitter=False)) as renderer:
        renderer.add_stage(turn, after="guides")
        renderer.add_stage(count, after="turn")
        renderer.uniforms.update({"turn.factor": 0.5, "turn.kept": 0.5})
        renderer.render()
        frame = renderer.render()
        assert [stage.name for stage in renderer.stages][:5] == ["gbuffer", "guides", "turn", "count", "camera_medium"]
        assert "turned" in frame
        assert frame.keys()[-2:] == ["turned", "counted"]
        np.testing.assert_allclose(frame["turned"], 0.75 * turned_normals(frame), rtol=2e-3)
        counted = frame["counted"]
        np.testing.assert_array_equal(counted, frame["turned"][..., 0] > 0.5)
        assert 0 < counted.mean() < 1
        [row] = [row for row in renderer.describe() if row.name == "count"]
        assert (row.stage, row.reads, row.writes, "turned" in row.barrier) == ("count", ("turned",), ("counted",), True)

        # What is shown: colors as they are, and a color for each integer.
        renderer.view = "turned"
        frame = renderer.render()
        shown = np.clip(frame["turned"][..., :3].astype(np.float32), 0, 1)
        np.testing.assert_allclose(frame["display"][..., :3] / 255, shown, atol=0.6 / 255)
        renderer.view = "counted"
        frame = renderer.render()
        colors = {tuple(color) for color in frame["display"][frame["counted"] == 1]}
        others = {tuple(color) for color in frame["display"][frame["counted"] == 0]}
        assert len(colors) == len(others) == 1
        assert colors != others

        # Another size, rendered at a half of it; another scene; other settings.
        renderer.settings.upscale = 2.0
        renderer.resize((40, 20))
        scene.instances[0].material.transmission = 0.5
        frame = renderer.render()
        assert (frame["turned"].shape, frame["counted"].shape) == ((20, 40, 4), (20, 40))
        assert (renderer.view, renderer.uniforms["turn.factor"]) == ("counted", 0.5)
        renderer.settings.lighting = "split"
        assert renderer.render()["turned"].any()
        renderer.remove_stage("count")
        frame = renderer.render()
        assert (renderer.view, "counted" in frame, "turned" in frame) == ("picture", False, True)
        with pytest.raises(sv.SolariError, match="there is no result 'counted'"):
            frame["counted"]


def test_a_stage_may_write_what_the_renderer_shows(device, folder):
    scene = sv.builtin("cornell_box")
    dim = sv.Stage("dim", passes=[sv.Pass("dim", threads=SIZE)], glsl_root=folder)
    with make_renderer(device, scene, SIZE) as plain, make_renderer(device, scene, SIZE) as renderer:
        renderer.add_stage(dim, after="taa")
        frame, bright = renderer.render(), plain.render()
        np.testing.assert_array_equal(frame["radiance"], 0.5 * bright["radiance"])
        assert frame["display"].mean() < bright["display"].mean()
        renderer.resize((12, 8))
        with pytest.raises(sv.SolariError, match=r"dim is made for 24x16 pixels.*a function of the size"):
            renderer.render()
        assert renderer.size == SIZE
        renderer.render()


def test_the_path_tracer_has_stages_too(device, folder):
    pixels = SIZE[0] * SIZE[1]
    mean = sv.Stage("mean", buffers={"green": pixels}, passes=[sv.Pass("mean", threads=SIZE)], glsl_root=folder)
    with sv.PathTracer(device, sv.builtin("cornell_box"), SIZE) as tracer:
        tracer.render(samples=2)
        tracer.add_stage(mean, after="reference")
        assert tracer.samples == 0
        frame = tracer.render(samples=4)
        np.testing.assert_array_equal(frame["green"], frame["radiance"][..., 1])
        with pytest.raises(sv.SolariError, match="PathTracer: there is no view 'green'; there are picture"):
            tracer.view = "green"
        with pytest.raises(sv.SolariError, match="mean is made for 24x16"):
            tracer.resize((12, 8))
        tracer.remove_stage("mean")
        tracer.resize((12, 8))
        assert tracer.render(samples=1)["radiance"].shape == (8, 12, 3)


def test_a_stage_that_draws(device, folder):
    """Its depth is a result and no view."""
    vertices = "vec2[](vec2(-1, -1), vec2(-1, 3), vec2(3, -1))[gl_VertexIndex]"
    (folder / "passes/fan.vert").write_text(f"#version 460\nvoid main() {{ gl_Position = vec4({vertices}, 0.25, 1); }}")
    fragment = "layout(location = 0) out float color;\nvoid main() { color = 0.5; }"
    (folder / "passes/fan.frag").write_text(f"#version 460\n{fragment}")

    def fan(size):
        draw = Draw("fan", [DrawList("commands", "command_count", 1, culls_backs=False)], ["drawn"], "near")
        buffers, images = {"commands": 1, "command_count": 1}, {"drawn": size, "near": size}
        return sv.Stage("fan", buffers, images, [sv.Pass("triangle", threads=1), draw], folder)

    with make_renderer(device, sv.builtin("cornell_box"), SIZE) as renderer:
        renderer.add_stage(fan, after="guides")
        assert "drawn" in renderer.known_views
        assert "near" not in renderer.known_views
        renderer.view = "drawn"
        frame = renderer.render()
        assert (frame["drawn"] == 0.5).all()
        assert (frame["near"] == 0.25).all()
        np.testing.assert_allclose(frame["display"][..., :3], 127.5, atol=1)


def test_views_of_any_name(device, folder):
    """A picture of another size is none, and the names of the renderer's own views are taken."""
    pixels = SIZE[0] * SIZE[1]
    buffers, images = {"size": pixels, "pcg": pixels}, {"pixel": SIZE, "small": (3, 3)}
    stage = sv.Stage("names", buffers, images, [sv.Pass("names", threads=SIZE)], folder)
    with make_renderer(device, sv.builtin("cornell_box"), SIZE) as renderer:
        with pytest.raises(sv.SolariError, match="stage own: the frame has 'motion'"):
            renderer.add_stage(sv.Stage("own", images={"motion": SIZE}), after="guides")
        renderer.add_stage(stage, after="guides")
        assert list(renderer.known_views)[-3:] == ["size", "pcg", "pixel"]
        shown = []
        for name in ("size", "pcg", "pixel"):
            renderer.view = name
            shown.append(renderer.render()["display"][3, 3])
        assert (shown[0] == shown[1]).all()
        assert abs(int(shown[2][0]) - 127) <= 1


def test_a_frame_whose_views_fail_has_its_former_stages(device, turn, monkeypatch):
    with make_renderer(device, sv.builtin("cornell_box"), SIZE) as renderer:
        names = [one.name for one in renderer.stages]
        with monkeypatch.context() as patch:
            patch.setattr(OwnStages, "views", lambda *_: 1 / 0)
            with pytest.raises(ZeroDivisionError):
                renderer.add_stage(turn, after="guides")
        assert [one.name for one in renderer.stages] == names
        renderer.render()


def test_which_stages_are_for_one_size(device, folder):
    pixels = SIZE[0] * SIZE[1]

    def fill(threads):
        return sv.Stage("fill", {"histogram": pixels}, passes=[sv.Pass("fill", threads=threads)], glsl_root=folder)

    with make_renderer(device, sv.builtin("cornell_box"), SIZE) as renderer:
        renderer.add_stage(fill([pixels, 1]), after="guides")
        renderer.resize((12, 8))
        assert renderer.render()["histogram"].shape == (pixels,)
        renderer.remove_stage("fill")
        renderer.add_stage(fill((12, 8, 1)), after="guides")
        renderer.resize(SIZE)
        with pytest.raises(sv.SolariError, match="stage fill is made for 12x8 pixels"):
            renderer.render()


def test_mistakes_leave_the_frame_as_it_was(device, folder, turn):
    def stage(name="own", shader="turn", **declared):
        return sv.Stage(name, passes=[sv.Pass(shader, threads=SIZE)], glsl_root=folder, **declared)

    wrong = [
        (lambda size: turn(size), "guide", "there is no stage 'guide'; did you mean 'guides'"),
        (stage("taa"), "guides", "the frame has a stage 'taa': give it another name"),
        (stage(images={"guides_depth": SIZE}), "guides", "stage own: the frame has 'guides_depth'"),
        (stage(images={"instances": SIZE}), "guides", "stage own: the frame has 'instances'"),
        (stage(images={"albedo": SIZE}), "guides", "stage own: the frame has 'albedo'"),
        (stage(images={"turnd": SIZE}), "guides", "stage own declares turnd, which none"),
        (stage(shader="broken"), "guides", "broken.comp:4: error.*missing"),
        (stage(shader="nothing"), "guides", "there is no shader passes/nothing.comp in"),
        (stage(shader="orphan"), "guides", "nobody .storage_image. is used by orphan, but no stage declares it"),
        ("edges", "guides", "takes a Stage, or a function .* not 'edges'"),
        (lambda size: None, "guides", "takes a Stage, or a function .* not None"),
    ]
    with make_renderer(device, sv.builtin("cornell_box"), SIZE) as renderer:
        names = [one.name for one in renderer.stages]
        for given, after, message in wrong:
            with pytest.raises(sv.SolariError, match=message):
                renderer.add_stage(given, after=after)
        with pytest.raises(sv.SolariError, match="there is no stage of your own 'guides'; there are none"):
            renderer.remove_stage("guides")
        assert [one.name for one in renderer.stages] == names
        renderer.render()
        renderer.add_stage(turn, after="camera_medium")
        with pytest.raises(sv.SolariError, match="the frame has a stage 'turn'"):
            renderer.add_stage(turn, after="guides")
        with pytest.raises(sv.SolariError, match="the frame has 'turned'"):
            renderer.add_stage(lambda size: turn(size, "again"), after="guides")
        renderer.add_stage(sv.Stage("last"), after="paths")
        renderer.settings.lighting = "split"
        with pytest.raises(sv.SolariError, match="stage last has no place: there is no stage to follow, 'paths'"):
            renderer.render()
        renderer.remove_stage("last")
        assert renderer.render()["turned"].shape == (16, 24, 4)


def test_shaders_are_compiled_anew(device, folder, turn):
    with make_renderer(device, sv.builtin("cornell_box"), SIZE) as renderer:
        renderer.add_stage(turn, after="guides")
        renderer.uniforms["turn.factor"] = 1.0
        file = folder / "passes/turn.comp"
        text = file.read_text()
        file.write_text(text.replace("abs(imageLoad", "2.0 * abs(imageLoad"))
        renderer.reload()
        frame = renderer.render()
        np.testing.assert_allclose(frame["turned"], 2 * turned_normals(frame), rtol=2e-3)
        file.write_text(text.replace("abs(", "apse("))
        with pytest.raises(CompilationError, match=r"turn\.comp"):
            renderer.reload()
        assert renderer.render()["turned"].any()
