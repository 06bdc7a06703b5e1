"""Light that pixels reuse (restir=on): it goes with its lamp and with the surfaces that reflect it, and its mean stays.

conformance/reuse_checks.py proves the mean without the world cache; other tests run with reuse among other lighting.
"""

from __future__ import annotations

import pytest
from support.frames import SIZE, find, settle
from support.measured import hold

import solari_vk as sv
from solari_vk.conformance.realtime import Effort, add_up, make_renderer, measure_mean, run_pictures
from solari_vk.conformance.rules import Rule
from solari_vk.gpu.shaders.patches import patched_shaders
from solari_vk.scene import shapes
from solari_vk.scene.builtin import cornell_box, lamp, matte

REUSE = {"lighting": "paths", "restir": True}
MEAN = Rule("frames with reused light are as bright as frames without", "solari_vk", "Frame")


def lit_by_a_wall():
    """A floor that no lamp lights and that fills the picture: its light comes from a lamp below it by a wall above."""
    scene = sv.Scene(sv.Camera.look_at((0, 1.2, 0.4), (0, 0, 0), vertical_fov=0.8))
    for name, mesh, material in (
        ("floor", shapes.quad((0, 0, 0), (0, 0, 1), (1, 0, 0)), matte(0.8)),
        ("wall", shapes.quad((0, 3, 0), (3, 0, 0), (0, 0, 3)), matte(0.9)),
        ("lamp", shapes.quad((0, -0.5, 0), (0, 0, 2), (2, 0, 0)), lamp(5.0)),
    ):
        scene.add(sv.Instance(mesh=mesh, material=material, name=name))
    return scene


def take_away(device, scene, name):
    """The light (h, w, 3) that surfaces reflect in a frame, and in the frame after the instance was removed."""
    with make_renderer(device, scene, SIZE, world_cache=False, **REUSE) as renderer:
        before = add_up(settle(renderer, scene.camera, 8))
        scene.remove(find(scene, name))
        return before, add_up(renderer.render(scene.camera))


@pytest.mark.parametrize(("make", "name"), [
    (cornell_box, "lamp"), (lit_by_a_wall, "lamp"), (lit_by_a_wall, "wall"),
])  # fmt: skip
def test_what_was_removed_lends_no_light(device, make, name):
    """Without the only lamp, or without the only surface that its light comes from, the next frame is black."""
    before, after = take_away(device, make(), name)
    assert (before > 0).mean() > 0.1
    assert not after.any()


@pytest.mark.slow
def test_a_removed_surface_that_still_lends_light_is_noticed(device):
    """The control of the test above."""
    with patched_shaders(("passes/paths/temporal.comp", "now.mesh != NO_INDEX && ", "")):
        _, after = take_away(device, lit_by_a_wall(), "wall")
    assert after.any()


@pytest.mark.slow
def test_many_lights(device):
    scene, effort = sv.builtin("many_lights", sphere_count=49, box_count=300), Effort(16, 24, 64)
    without, found = (observe(device, scene, effort, restir) for restir in (False, True))
    hold([measure_mean(MEAN, found, without.mean(axis=0), 0.02, effort)])


def observe(device, scene, effort, restir):
    """The reflected light (runs, h, w, 3) of independent runs."""
    with make_renderer(device, scene, SIZE, lighting="paths", restir=restir) as renderer:
        return run_pictures(renderer, scene.camera, effort, add_up)
