"""Lamps whose light is a small part of all light, and most of the light where they are: denoised frames follow them."""

from __future__ import annotations

import numpy as np
import pytest
from support.frames import frames_in_history, make_renderer, render_frames
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
    room = shapes.box(corner, (x + 2, y + 2, z + 3), inward=True)
    scene.add(sv.Mesh(room.positions, room.triangles[:-2]), matte(0.7))
    scene.add(shapes.quad((x + 1, y + 1.98, z + 1.4), (0.4, 0, 0), (0, 0, 0.4)), lamp(radiance), name=name)


def two_rooms():
    """A room whose lamp is a hundred times as bright as that of the room beside it, which gets no light of it."""
    scene = sv.Scene(sv.Camera.look_at((0.3, 1, 4.5), (0.3, 1, 0), vertical_fov=0.85))
    add_room(scene, (-2.3, 0.8, -3.5), 100.0, "bright")
    add_room(scene, (0.3, 0.0, -2.0), 1.0, "dim")
    return scene, scene.instances["dim"]


def light_after(device, scene, change, frames, seeds=SEEDS):
    """The dim room's light in the frames after a change, over its light before. `change(step)` makes the scene anew for
    step 0, and changes it for step 1."""

    def light(count):
        frames = [np.asarray(renderer.render()["diffuse_radiance"], np.float64) for _ in range(count)]
        return np.array([frame[DIM_ROOM].mean() for frame in frames])

    shares = []
    with make_renderer(device, scene, SIZE, denoise=True) as renderer:
        for seed in seeds:
            renderer.seed = seed
            renderer.reset()
            change(0)
            render_frames(renderer, scene.camera, 40)
            before = light(8).mean()
            change(1)
            shares.append(light(frames) / before)
    found = np.mean(shares, axis=0)
    print(np.round(found, 3))
    return found


def left_after_dimming(device, to, seeds=SEEDS):
    """The share of the dim room's superfluous light that is left in frames 1 to 20 after its lamp was dimmed to a
    share of its light: 0 when the frame is right, 1 when it is as before. (20,)"""
    scene, light = two_rooms()
    change = lambda step: light.material.update(emissive=np.full(3, to if step else 1.0))  # noqa: E731
    return (light_after(device, scene, change, 20, seeds) - to) / (1 - to)


def test_a_weak_lamp_that_goes_out(device):
    left = left_after_dimming(device, 0.0)
    assert left[9] < 0.05
    assert left[19] < 0.03


@pytest.mark.slow
def test_a_weak_lamp_that_is_dimmed(device):
    """The standard error of a frame's share is 0.17 with one seed, 0.035 with 24."""
    left = left_after_dimming(device, 0.5, range(50, 74))
    assert abs(left[:10]).max() < 0.2
    assert abs(left[:10].mean()) < 0.1


@pytest.mark.slow
def test_a_weak_lamp_that_is_carried_away(device):
    """It counts where it was, too."""
    scene, light = two_rooms()
    change = lambda step: light.update(transform=place(at=(0, 60 * step, 0)))  # noqa: E731
    assert light_after(device, scene, change, 12, seeds=[50])[8:].mean() < 0.05


# ---- most of the light goes out ----------------------------------------------------------------------


def sun_and_lamp():
    """A room that is open towards the camera, where the sun brings many times the light of a lamp."""
    scene = sv.Scene(sv.Camera.look_at((1, 1, 4.5), (1, 1, 0), vertical_fov=0.7))
    add_room(scene, (0, 0, -3), 3.0, "lamp")
    scene.add(sv.DirectionalLight((0.1, -0.5, -1), illuminance=50.0, name="sun"))
    return scene


def check_most_light_goes(device, lighting):
    """Frames 0, 1, 2 and 15 after a sun is removed, over what they tend to: means over the picture."""
    light = lambda count: [np.mean(renderer.render()["diffuse_radiance"]) for _ in range(count)]  # noqa: E731
    scene = sun_and_lamp()
    with make_renderer(device, scene, SIZE, denoise=True, lighting=lighting) as renderer:
        render_frames(renderer, scene.camera, 24)
        scene.remove(scene.lights["sun"])
        found = np.array(light(16))[[0, 1, 2, 15]] / np.mean(light(64)[-16:])
    print(lighting, np.round(found, 3))
    assert np.abs(found - 1).max() < 0.1


@pytest.mark.parametrize("lighting", ["paths", "split"])
def test_most_of_the_light_goes_out(device, lighting):
    check_most_light_goes(device, lighting)


# ---- flicker ----------------------------------------------------------------------------------------


def history_under_flicker(device, what):
    """The median length of histories after 40 frames in which a lamp's light or place changes a little."""
    scene = cornell_box()
    lamp = scene.instances["lamp"]
    radiance, at = np.array(lamp.material.emissive), np.array(lamp.transform)
    with make_renderer(device, scene, SIZE, denoise=True) as renderer:
        for frame in range(40):
            if what == "power":
                lamp.material.emissive = radiance * (1 + 0.02 * (frame % 2))
            else:
                lamp.transform = place(at=(0.004 * (frame % 2), 0, 0)) @ at
            found = renderer.render()
        return np.median(frames_in_history(found))


@pytest.mark.parametrize("what", ["power", pytest.param("place", marks=pytest.mark.slow)])
def test_flicker_keeps_histories(device, what):
    assert history_under_flicker(device, what) > 30


@pytest.mark.slow
def test_lists_of_all_changes_are_noticed(device, monkeypatch):
    monkeypatch.setattr(recent_changes, "MIN_LISTED_CHANGE", 0.0)
    assert history_under_flicker(device, "power") < 10


test_a_seeded_bug_is_noticed = bug_tests(
    {
        "a weak lamp goes out: places of lights are unknown": (
            test_a_weak_lamp_that_goes_out,
            Bug("passes/light_change.glsl", "light_change", "return 0.0;"),
        )
    }
)
