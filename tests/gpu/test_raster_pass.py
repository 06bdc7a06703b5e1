"""Draws in a frame: depth, faces, indirect commands and counts, attachments with history, barriers, errors."""

from __future__ import annotations

import numpy as np
import pytest

from solari_vk.base.errors import SolariError, ValidationError
from solari_vk.gpu.frame.frame import Draw, DrawList, Frame, History, Pass, Stage
from solari_vk.gpu.shaders.compiler import CompilationError

SIZE = (8, 8)
BINDINGS = """#ifndef BINDINGS
#define BINDINGS
layout(set = 1, binding = 0, scalar) uniform UniformsBlock { uint count; float depth_step; uint clockwise; } uniforms;
struct Command { uint vertices; uint instances; uint first_vertex; uint first_instance; };
layout(set = 1, binding = 1, scalar) buffer CommandsBlock { Command at[]; } commands;
layout(set = 1, binding = 2, scalar) buffer CountsBlock { uint at[2]; } counts;
layout(set = 1, binding = 3, r32ui) uniform uimage2D who;
layout(set = 1, binding = 4, r32ui) uniform uimage2D previous_who;
layout(set = 1, binding = 5, rgba32f) uniform image2D color;
layout(set = 1, binding = 6, scalar) buffer SumBlock { uint drawn; } sum;
#endif
"""
COMMANDS = """#include "passes/bindings.glsl"
layout(local_size_x = 4) in;
void main() {
    uint i = gl_GlobalInvocationID.x;
    if (imageSize(who) != imageSize(color)) { return; }
    commands.at[i] = Command(6u, uint(i < uniforms.count), 0u, i);
    if (i == 0u) { counts.at[0] = 77u; counts.at[1] = uniforms.count; }
}
"""
# Instance i covers the columns from i on; depth_step is the depth between successive instances.
VERTEX = """#version 460
#extension GL_EXT_scalar_block_layout : require
#include "passes/bindings.glsl"
layout(location = 0) flat out uint instance;
void main() {
    uint corner = uint[](0u, 1u, 2u, 1u, 3u, 2u)[gl_VertexIndex];
    if (uniforms.clockwise == 0u) { corner = uint[](0u, 2u, 1u, 3u)[corner]; }  // turned over
    vec2 place = vec2(corner & 1u, corner >> 1u);
    instance = gl_InstanceIndex;
    float left = -1.0 + 0.25 * gl_InstanceIndex;
    gl_Position = vec4(mix(left, 1.0, place.x), 2.0 * place.y - 1.0, 0.5 + uniforms.depth_step * gl_InstanceIndex, 1.0);
}
"""
FRAGMENT = """#version 460
#extension GL_EXT_scalar_block_layout : require
#include "passes/bindings.glsl"
layout(constant_id = 0) const uint base = 10u;
layout(location = 0) flat in uint instance;
layout(location = 0) out uint out_who;
layout(location = 1) out vec4 out_color;
void main() {
    out_who = base + instance;
    out_color = vec4(gl_FragCoord.xyz, gl_FrontFacing ? 1.0 : 0.0);
    atomicAdd(sum.drawn, 1u);
}
"""
READ = """#include "passes/bindings.glsl"
layout(local_size_x = 8, local_size_y = 8) in;
void main() {
    ivec2 at = ivec2(gl_GlobalInvocationID.xy);
    imageStore(color, at, vec4(imageLoad(who, at).x, imageLoad(previous_who, at).x, 0.0, 0.0));
}
"""


@pytest.fixture
def root(shaders):
    shaders.write("passes/bindings.glsl", BINDINGS)
    shaders.write("commands", COMMANDS)
    shaders.write("read", READ)
    shaders.write("passes/draw.vert", VERTEX)
    shaders.write("passes/draw.frag", FRAGMENT)
    return shaders.root


def draw(culls_backs=True, max_count=4, **fields) -> Draw:
    lists = [DrawList("commands", "counts", max_count, count_offset=4, culls_backs=culls_backs)]
    return Draw("draw", **{"draws": lists, "colors": ("who", "color"), "depth": "nearest"} | fields)


def stage(*passes, **images) -> Stage:
    images = {"who": History(SIZE), "color": SIZE, "nearest": SIZE} | images
    return Stage("raster", buffers={"commands": 4, "counts": 1, "sum": 1}, images=images, passes=passes)


def render(frame, count, depth_step=0.0, clockwise=0):
    for name, value in {"count": count, "depth_step": depth_step, "clockwise": clockwise}.items():
        frame.uniforms[f"uniforms.{name}"] = value
    frame.submit()
    return frame["who"][..., 0]


COLUMNS = np.arange(8)


@pytest.mark.parametrize("counted", [True, False], ids=["counts from a buffer", "no drawIndirectCount"])
def test_draws_what_the_buffer_says(device, root, counted, monkeypatch):
    """The count buffer decides how many draws there are, the nearest is visible, each has its own first instance."""
    if not counted:
        monkeypatch.setattr(device, "features", device.features - {"drawIndirectCount"})
    with Frame(device, [stage(Pass("commands", threads=4), draw())], glsl_root=root) as frame:
        for count in (4, 1, 0, 3):
            nearer = render(frame, count, 0.1)
            np.testing.assert_array_equal(nearer[3], 10 + np.minimum(COLUMNS, count - 1) if count else 0 * COLUMNS)
            assert (nearer == nearer[0]).all()
            np.testing.assert_array_equal(render(frame, count, -0.1), 10 if count else 0)
        y, x = np.mgrid[0:8, 0:8] + 0.5
        np.testing.assert_allclose(frame["color"], np.stack([x, y, 0 * x + 0.5, 0 * x + 1], -1), atol=1e-6)


def test_faces(device, root):
    """Triangles that are counter-clockwise in the picture are front faces."""
    with Frame(device, [stage(Pass("commands", threads=4), draw())], glsl_root=root) as frame:
        assert (render(frame, 1, clockwise=0) == 10).all()
        assert (render(frame, 1, clockwise=1) == 0).all()
    with Frame(device, [stage(Pass("commands", threads=4), draw(culls_backs=False))], glsl_root=root) as frame:
        assert (render(frame, 1, clockwise=1) == 10).all()
        assert (frame["color"][..., 3] == 0).all()


def test_history_reading_and_a_second_draw(device, root):
    """Attachments may have history. A draw that doesn't clear continues on the colors and depths of the first draw."""
    again = draw(clears=False, constants={"base": 20})
    passes = [Pass("commands", threads=4), draw(), Pass("read", threads=SIZE), again]
    with Frame(device, [stage(*passes)], glsl_root=root) as frame:
        render(frame, 1)
        first = frame["who"][..., 0].copy()
        assert (first == 10).all(), "the second draw is no nearer, so nothing of it passes"
        render(frame, 3, 0.1)
        np.testing.assert_array_equal(frame["color"][0, :, 0], [10, 11, 12, 12, 12, 12, 12, 12])
        np.testing.assert_array_equal(frame["color"][..., 1], first)
        assert {row.name: row.barrier for row in frame.describe()} == {
            "commands": "",
            "draw #1": "RAW commands (commands), RAW counts (commands)",
            "read": "RAW who (draw #1), WAW color (draw #1)",
            "draw #2": "WAR who (read), WAW color (read)",
        }
        assert set(frame.timings) == {"commands", "draw #1", "read", "draw #2"}


@pytest.mark.provokes_validation
def test_synchronization_validation_sees_a_missing_barrier(device, root):
    """The missing barrier is that of the draw commands: Debian's layer doesn't track attachments here."""
    with Frame(device, [stage(Pass("commands", threads=4), draw())], glsl_root=root) as frame:
        frame._barriers[1] = None
        with pytest.raises(ValidationError, match=r"(?i)hazard"):
            frame.submit()


def test_rebuilding(device, root, shaders):
    """A changed fragment shader is used, a broken one changes nothing, and attachments may get another size."""
    with Frame(device, [stage(Pass("commands", threads=4), draw())], glsl_root=root) as frame:
        render(frame, 1)
        shaders.write("passes/draw.frag", FRAGMENT.replace("= base + instance", "= 2u * base"))
        frame.rebuild()
        assert (render(frame, 1) == 20).all()
        shaders.write("passes/draw.vert", VERTEX.replace("vec2 place", "vec2 plaice"))
        with pytest.raises(CompilationError, match=r"draw\.vert:\d+"):
            frame.rebuild()
        assert (render(frame, 1) == 20).all()
        shaders.write("passes/draw.vert", VERTEX)
        other = (16, 5)
        frame.rebuild([stage(Pass("commands", threads=4), draw(), who=History(other), color=other, nearest=other)])
        assert (render(frame, 1) == 20).all()
        assert frame["who"].shape == frame.resource("nearest").read().shape == (5, 16, 1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"colors": ("who", "sum")}, "sum is a storage_buffer"),
        ({"colors": ("who", "elsewhere")}, "no shader has a resource elsewhere"),
        ({"depth": "elsewhere"}, "nearest, which none of the frame's shaders uses"),
        ({"draws": [DrawList("commands", "counts", 0)]}, "0 draws"),
        ({"draws": [DrawList("command", "counts", 4)]}, "there is no resource command;"),
        ({"constants": {"bas": 1}}, "no specialization constant bas; those it uses are base"),
    ],
)
def test_what_cannot_be_drawn_is_said(device, root, change, message):
    with pytest.raises(SolariError, match=message):
        Frame(device, [stage(Pass("commands", threads=4), draw(**change))], glsl_root=root)


def test_images_of_two_sizes_and_devices_without_indirect_draws(device, root, monkeypatch):
    frame = Frame(device, [stage(Pass("commands", threads=4), draw(), color=(8, 9))], glsl_root=root)
    with frame, pytest.raises(SolariError, match="color and nearest differ in size"):
        frame.submit()
    monkeypatch.setattr(device, "features", device.features - {"multiDrawIndirect"})
    with pytest.raises(SolariError, match="since it lacks multiDrawIndirect"):
        Frame(device, [stage(Pass("commands", threads=4), draw())], glsl_root=root)
