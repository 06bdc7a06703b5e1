"""Motion vectors against the scene's own motion, within 1/16 of a pixel; what a reused row or a new instance does."""

from __future__ import annotations

import math

import numpy as np
import pytest
from gbuffer_frames import NOTHING, GBufferFrames, decode, pixel_directions, project
from test_gbuffer import camera_of, make_scene

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.binder import SceneBinder
from solari_vk.scene.builtin import matte, place
from solari_vk.scene.matrices import transform_points

SIZE = (96, 64)
MOST = 1 / 16  # of a pixel


def turned(transform, angles, shift):
    """The transform turned about its own place, and moved."""
    result = transform.copy()
    for axis, angle in enumerate(angles):
        rotation = np.eye(3)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        rotation[i, i] = rotation[j, j] = math.cos(angle)
        rotation[i, j], rotation[j, i] = -math.sin(angle), math.sin(angle)
        result[:3, :3] = rotation @ result[:3, :3]
    result[:3, 3] += shift
    return result


def check_motion(device, gbuffer="raster", glsl=None):
    """A camera that moves, turns and zooms over things that move, turn, grow and turn inside out, jittered."""
    scene = make_scene("material_zoo")
    still = sv.Instance(mesh=shapes.sphere(0.2, 12), material=matte(0.3), transform=place(1.0, (0, 0.5, 0.5)))
    scene.add(still)
    instances = list(scene.instances)
    rng = np.random.default_rng(4)
    camera = camera_of(scene)
    binder = SceneBinder(device, scene)
    binder.update()
    worst = largest = 0.0
    with GBufferFrames(device, binder, SIZE, glsl, gbuffer=gbuffer) as frames:
        jitter = rng.uniform(-0.5, 0.5, 2)
        frames.render(camera, jitter)
        for _ in range(4):
            before = [instance.transform for instance in instances]
            previous = sv.Camera(transform=camera.transform, vertical_fov=camera.vertical_fov)
            camera = sv.Camera(
                transform=turned(camera.transform, rng.uniform(-0.03, 0.03, 3), rng.uniform(-0.1, 0.1, 3)),
                vertical_fov=camera.vertical_fov * rng.uniform(0.95, 1.05),
            )
            for instance in instances[:-2]:
                moved = turned(instance.transform, rng.uniform(-0.1, 0.1, 3), rng.uniform(-0.05, 0.05, 3))
                moved[:3, :3] *= rng.uniform(0.95, 1.05)
                instance.transform = moved
            binder.update()
            jitter = rng.uniform(-0.5, 0.5, 2)
            found = decode(frames.render(camera, jitter))
            there = found["depth"] > 0
            distance = np.where(there, camera.near / np.where(there, found["depth"], 1), 1e9)
            directions = pixel_directions(camera, SIZE, jitter)
            world = camera.transform[:3, 3] + distance[..., None] * directions
            was = world.copy()
            was[~there] += previous.transform[:3, 3] - camera.transform[:3, 3]
            for row, instance in binder.instances.items():
                here = found["instance"] == row
                step = before[instances.index(instance)] @ np.linalg.inv(instance.transform)
                was[here] = transform_points(step, world[here])
            expected = project(previous, SIZE, was) - project(camera, SIZE, world)
            worst = max(worst, np.abs(found["motion"] * SIZE - expected).max())
            largest = max(largest, np.abs(expected).max())
    binder.destroy()
    assert largest > 5, "the test must have motion to measure"
    assert worst < MOST, f"off by {worst:.3f} pixels"
    return worst


@pytest.mark.parametrize("gbuffer", ["raster", "traced"])
def test_motion_is_the_scene_s(device, gbuffer):
    check_motion(device, gbuffer)


def check_rows(device, glsl=None):
    """An instance in the row of one that is gone, or a new one, has no past: it counts as having stood still."""
    mesh, material = shapes.box(), matte(0.5)
    first = sv.Instance(mesh=mesh, material=material, transform=place(1.0, (-1, 0, 0)))
    scene = sv.Scene(first)
    camera = sv.Camera.look_at((0, 0, 5), (0, 0, 0))
    binder = SceneBinder(device, scene)
    binder.update()
    with GBufferFrames(device, binder, SIZE, glsl) as frames:
        found = decode(frames.render(camera))
        assert set(np.unique(found["instance"])) == {0, NOTHING}
        scene.remove(first)
        scene.add(sv.Instance(mesh=mesh, material=material, transform=place(1.0, (1, 0, 0))))
        binder.update()
        assert list(binder.instances) == [0]
        seen = frames.render(camera)
        assert seen["drawn_second"] == 1, "what was visible in the row isn't what is there now"
        found = decode(seen)
        assert set(np.unique(found["instance"])) == {0, NOTHING}
        assert (found["motion"] == 0).all()
        assert found["instance"][32, 66] == 0
        assert found["instance"][32, 30] == NOTHING
        # more than the rows there is room for
        for y in range(-9, 9):
            scene.add(sv.Instance(mesh=mesh, material=material, transform=place(0.1, (0, y, 0))))
        binder.update()
        found = decode(frames.render(camera))
        assert len(np.unique(found["instance"])) > 3
        assert (found["motion"] == 0).all()
        for instance in list(scene.instances):
            scene.remove(instance)
        binder.update()
        assert (frames.render(camera)["gbuffer_surface"][..., 1] == NOTHING).all()
    binder.destroy()


def test_rows_of_other_instances_have_no_past(device):
    check_rows(device)


def test_resize_between_frames(device):
    """After a resize the picture is as if it had always had that size, and history is empty."""
    scene = make_scene("cornell_box")
    binder = SceneBinder(device, scene)
    binder.update()
    camera = camera_of(scene)
    with GBufferFrames(device, binder, SIZE) as frames, GBufferFrames(device, binder, (50, 70)) as other:
        frames.render(camera)
        frames.size = (50, 70)
        frames._previous = None
        found, expected = frames.render(camera), other.render(camera)
        for name in ("gbuffer", "gbuffer_surface", "depth", "motion_vectors"):
            np.testing.assert_array_equal(found[name], expected[name])
        assert not frames._frame["previous_depth"].any()
        again = frames.render(camera)
        np.testing.assert_array_equal(frames._frame["previous_depth"], found["depth"])
        np.testing.assert_array_equal(frames._frame["previous_gbuffer"], found["gbuffer"])
        np.testing.assert_array_equal(again["depth"], found["depth"])
    binder.destroy()
