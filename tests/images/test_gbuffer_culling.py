"""Culling never drops a visible pixel: along a camera path every combination gives the very same G-buffer."""

from __future__ import annotations

import math

import numpy as np
from gbuffer_frames import IMAGES, GBufferFrames
from test_gbuffer_motion import turned

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.binder import SceneBinder
from solari_vk.scene.builtin import matte, place

SIZE = (88, 54)
VARIANTS = {
    "none": {"frustum_culling": False, "occlusion_culling": False},
    "frustum": {"frustum_culling": True, "occlusion_culling": False},
    "occlusion": {"frustum_culling": False, "occlusion_culling": True},
    "both": {},
}


WALLS = 30


def random_world(rng, count=280):
    """Rooms' worth of things of all sizes between walls that hide them, some mirrored, sheared or double-sided."""
    meshes = [shapes.sphere(0.5, 10), shapes.box(), shapes.quad((0, 0, 0), (0.5, 0, 0), (0, 0.5, 0))]
    materials = [matte(0.5), matte((0.8, 0.3, 0.1)), matte((0.2, 0.4, 0.9), double_sided=True)]
    scene = sv.Scene()
    for index in range(count):
        wall = index < WALLS
        scale = rng.uniform((5, 5, 0.1), (9, 9, 0.3)) if wall else np.exp(rng.uniform(-3, 0.3, 3))
        transform = np.eye(4)
        transform[:3, :3] = rng.normal(0, 0.2, (3, 3)) + np.eye(3)
        transform[:3, :3] = transform[:3, :3] @ np.diag(scale * rng.choice((-1, 1), 3))
        transform = turned(transform, rng.uniform(-3, 3, 3), rng.uniform(-7, 7, 3))
        if index % 2 and not wall:  # half of them stick in walls
            host = list(scene.instances)[rng.integers(WALLS)]
            transform[:3, 3] = (host.transform @ (*rng.uniform(-0.5, 0.5, 3), 1))[:3]
        mesh = meshes[1] if wall else meshes[rng.integers(3)]
        scene.add(sv.Instance(mesh=mesh, material=materials[rng.integers(3)], transform=transform))
    return scene


def check_culling(device, frame_count=40, seed=8, glsl=None):
    """Returns the counters' sums over the frames of "both"."""
    rng = np.random.default_rng(seed)
    scene = random_world(rng)
    instances = list(scene.instances)
    binder = SceneBinder(device, scene)
    binder.update()
    frames = {name: GBufferFrames(device, binder, SIZE, glsl, **chosen) for name, chosen in VARIANTS.items()}
    sums = dict.fromkeys(("drawn_first", "drawn_second", "frustum_culled", "occlusion_culled"), 0)
    eye, target = rng.uniform(-9, 9, 3), rng.uniform(-3, 3, 3)
    for number in range(frame_count):
        jump = number % 10 == 9  # a cut: what was visible last frame means nothing
        eye, target = (at + rng.uniform(-0.2, 0.2, 3) for at in (eye, target))
        if jump:
            eye, target = rng.uniform(-9, 9, 3), rng.uniform(-3, 3, 3)
        camera = sv.Camera.look_at(eye, target, vertical_fov=rng.uniform(1.0, 1.6))
        for _ in range(5):
            moved = instances[rng.integers(WALLS, len(instances))]
            moved.transform = turned(moved.transform, rng.uniform(-0.5, 0.5, 3), rng.uniform(-0.5, 0.5, 3))
        if number % 4 == 3:
            scene.remove(gone := instances.pop(WALLS))
            instances.append(sv.Instance(mesh=gone.mesh, material=gone.material, transform=gone.transform))
            scene.add(instances[-1])
            instances[-2].visible = not instances[-2].visible
        binder.update()
        jitter = rng.uniform(-0.5, 0.5, 2)
        found = {name: each.render(camera, jitter) for name, each in frames.items()}
        for name, each in found.items():
            for image in IMAGES:
                wrong = (each[image] != found["none"][image]).any(-1).sum()
                assert not wrong, f"frame {number}, {name} culling: {wrong} pixels of {image} differ"
            visible = sum(instance.visible for instance in instances)
            assert sum(each[counter] for counter in sums) == visible, f"{name}: every instance is counted once"
        for counter in sums:
            sums[counter] += found["both"][counter]
        assert found["none"]["drawn_first"] == sum(instance.visible for instance in instances)
        assert found["frustum"]["occlusion_culled"] == 0
        assert found["occlusion"]["frustum_culled"] == 0
    for each in frames.values():
        each.__exit__()
    binder.destroy()
    assert all(total > frame_count for total in sums.values()), f"each kind of culling must have had work: {sums}"
    return sums


def test_culling_drops_nothing_that_is_seen(device):
    check_culling(device)


def check_counts(device, glsl=None):
    """A wall before a row of boxes: one is seen, those behind it are not, those beside the view neither."""
    box = shapes.box()
    scene = sv.Scene(
        sv.Instance(mesh=shapes.quad((0, 0, 0), (9, 0, 0), (0, 9, 0)), material=matte(0.5), name="wall"),
    )
    for at in ((0, 0, 2), *((x, 0.3, -4 - x) for x in range(-2, 3)), (30, 0, 0), (0, 0, 30)):
        scene.add(sv.Instance(mesh=box, material=matte(0.5), transform=place(0.5, at)))
    binder = SceneBinder(device, scene)
    binder.update()
    camera = sv.Camera.look_at((0, 0, 8), (0, 0, 0))
    away = sv.Camera.look_at((0, 0, 8), (0, 0, 90), vertical_fov=math.radians(20))
    with GBufferFrames(device, binder, SIZE, glsl) as frames:
        seen = []
        for view in (camera, camera, camera, away, away, camera):
            found = frames.render(view)
            seen.append([found[name] for name in ("drawn_first", "drawn_second", "frustum_culled", "occlusion_culled")])
        frames.settings.occlusion_culling = False
        found = frames.render(camera)
        seen.append([found[name] for name in ("drawn_first", "drawn_second", "frustum_culled", "occlusion_culled")])
    binder.destroy()
    assert seen == [
        [0, 7, 2, 0],  # nothing was visible before, so nothing hides anything yet
        [7, 0, 2, 0],
        [2, 0, 2, 5],
        [0, 1, 8, 0],
        [1, 0, 8, 0],
        [0, 7, 2, 0],
        [7, 0, 2, 0],
    ]


def test_counts(device):
    check_counts(device)
