"""Lamps whose light is a small part of all light, and most of the light where they are: denoised frames follow them."""

from __future__ import annotations

import numpy as np
import pytest
from support.frames import find, frames_in_history, settle
from support.realtime import make_renderer
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.bound.lights import recent_changes
from solari_vk.scene import shapes
from solari_vk.scene.builtin import cornell_box, lamp, matte, place

SIZE = (48, 48)
SEEDS = range(50, 53)
DIM_ROOM = np.s_[12:36, 39:45]  # rows and columns of the picture, where the blur brings nothing of the bright room


def add_room(scene, corner, radiance, name):
    """A closed room of 2 x 2 x 3 meters, open towards the camera, with a lamp below its ceiling."""
    x, y, z = corner
    wide, high, deep = (2, 0, 0), (0, 2, 0), (0, 0, 3)
    for at, along, across in (((x, y, z), deep, wide), ((x, y + 2, z), wide, deep), ((x, y, z), wide, high),
                              ((x, y, z), high, deep), ((x + 2, y, z), deep, high)):  # fmt: skip
        scene.add(shapes.quad(at, along, across), matte(0.7))
    scene.add(shapes.quad((x + 0.6, y + 1.98, z + 1), (0.8, 0, 0), (0, 0, 0.8)), lamp(radiance), name=name)


def two_rooms():
    """A room whose lamp is a hundred times as bright as that of the room beside it, which gets no light of it."""
    scene = sv.Scene()
    add_room(scene, (-2.3, 0.8, -3.5), 100.0, "bright")
    add_room(scene, (0.3, 0.0, -2.0), 1.0, "dim")
    scene.add(sv.Camera.look_at((0.3, 1, 4.5), (0.3, 1, 0), vertical_fov=0.85))
    return scene


def left_after_dimming(device, to):
    """The share of the dim room's superfluous light that is left in frames 1 to 20 after its lamp was dimmed to a
    share of its light: 0 when the frame is right, 1 when it is as before. (20,)"""
    scene = two_rooms()
    light = find(scene, "dim").material
    left = []
    with make_renderer(device, scene, SIZE, denoise=True) as renderer:
        for seed in SEEDS:
            renderer.seed = seed
            renderer.reset()
            light.emissive = np.ones(3)
            settle(renderer, scene.camera, 40)
            before = np.mean([read(renderer.render()) for _ in range(8)])
            light.emissive = np.full(3, to)
            left.append([(read(renderer.render()) / before - to) / (1 - to) for _ in range(20)])
    found = np.mean(left, axis=0)
    print(to, np.round(found, 3))
    return found


def read(frame):
    return np.asarray(frame["diffuse_radiance"], np.float64)[DIM_ROOM].mean()


def test_a_weak_lamp_that_goes_out(device):
    left = left_after_dimming(device, 0.0)
    assert left[9] < 0.05
    assert left[19] < 0.03


@pytest.mark.slow
def test_a_weak_lamp_that_is_dimmed(device):
    left = left_after_dimming(device, 0.5)
    assert abs(left[:10]).max() < 0.2
    assert abs(left[:10].mean()) < 0.1


@pytest.mark.slow
def test_a_weak_lamp_that_is_carried_away(device):
    """It counts where it was, too."""
    scene = two_rooms()
    light = find(scene, "dim")
    with make_renderer(device, scene, SIZE, denoise=True) as renderer:
        settle(renderer, scene.camera, 40)
        before = np.mean([read(renderer.render()) for _ in range(8)])
        light.transform = place(at=(0, 60, 0)) @ light.transform
        left = [read(renderer.render()) / before for _ in range(12)]
    print(np.round(left, 3))
    assert np.mean(left[8:]) < 0.05


FLICKER = {"power": 0.02, "place": 0.004}  # of the power, to and fro; in meters


def history_under_flicker(device, what):
    """The median length of histories after 40 frames in which a lamp's light or place changes a little."""
    scene = cornell_box()
    lamp = find(scene, "lamp")
    material, at = lamp.material, np.array(lamp.transform)
    radiance = np.array(material.emissive)
    with make_renderer(device, scene, SIZE, denoise=True) as renderer:
        for frame in range(40):
            if what == "power":
                material.emissive = radiance * (1 + FLICKER[what] * (frame % 2))
            else:
                lamp.transform = place(at=(FLICKER[what] * (frame % 2), 0, 0)) @ at
            found = renderer.render()
        median = np.median(frames_in_history(found))
    print(what, median)
    return median


@pytest.mark.parametrize("what", ["power", pytest.param("place", marks=pytest.mark.slow)])
def test_flicker_keeps_histories(device, what):
    assert history_under_flicker(device, what) > 30


@pytest.mark.slow
def test_lists_of_all_changes_are_noticed(device, monkeypatch):
    monkeypatch.setattr(recent_changes, "LISTED", 0.0)
    assert history_under_flicker(device, "power") < 10


test_a_seeded_bug_is_noticed = bug_tests({
    "a weak lamp goes out: places of lights are unknown": (test_a_weak_lamp_that_goes_out, Bug(
        "passes/light_change.glsl", "light_change", "return 0.0;")),
})  # fmt: skip
