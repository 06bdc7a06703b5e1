"""The G-buffer: raster against rays, motion vectors against the scene's own motion, and culling against none."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

import solari_vk as sv
from solari_vk.conformance.realtime import OFF, make_renderer
from solari_vk.conformance.rules import SUITE, Measurement, Rule
from solari_vk.gpu.device.device import Device
from solari_vk.renderer import RenderedFrame, Renderer
from solari_vk.scene import shapes
from solari_vk.scene.builtin import matte, place
from solari_vk.scene.matrices import transform_points

_GBUFFER = (SUITE, "G-buffer")
RASTER = Rule("raster finds the surfaces that rays find", *_GBUFFER)
MOTION = Rule("motion vectors follow the camera", *_GBUFFER)
INSTANCE_MOTION = Rule("motion vectors follow moving instances", *_GBUFFER)
CULLING = Rule("culling drops nothing that is seen", *_GBUFFER)
SIZE = (64, 48)
_MOST = 1 / 16  # of a pixel
_IMAGES = ("gbuffer", "gbuffer_surface", "depth", "motion_vectors")
_CULLED = ("frustum_culled", "occlusion_culled")


def measure_gbuffer(device: Device) -> Iterator[Measurement]:
    """Raster against rays where both see the same object, and motion against the camera's own."""
    scene = sv.builtin("sphere_grid", columns=4, rows=2)
    found = {}
    for way in ("raster", "traced"):
        with make_renderer(device, scene, SIZE, gbuffer=way, jitter=False) as renderer:
            frame = renderer.render(scene.camera)
            found[way] = frame["depth"][..., 0].astype(np.float64), frame["gbuffer_surface"][..., 1].copy()
    (depth, instance), (traced_depth, traced_instance) = found.values()
    apart = np.abs(depth - traced_depth) > 1e-3 * np.maximum(traced_depth, 1e-9)
    wrong = float(((instance != traced_instance) | apart).mean())
    yield Measurement(RASTER, wrong, 0.01, "of pixels differ", "edges may")

    with make_renderer(device, scene, SIZE, jitter=False) as renderer:
        renderer.render(scene.camera)
        moved = scene.camera.transform.copy()
        moved[:3, 3] += (0.2, -0.1, -0.3)
        camera = sv.Camera(transform=moved, vertical_fov=scene.camera.vertical_fov, near=scene.camera.near)
        error, _ = _find_motion_error(renderer.render(camera), camera, scene.camera)
    yield Measurement(MOTION, error, _MOST, "of a pixel")


# ---- motion -----------------------------------------------------------------------------------------


def _slope(camera: sv.Camera) -> NDArray[np.float64]:
    return math.tan(camera.vertical_fov / 2) * np.array((SIZE[0] / SIZE[1], -1.0))


def _project(camera: sv.Camera, positions: NDArray[Any]) -> NDArray[Any]:
    """Pixels (..., 2) at which world positions (..., 3) lie."""
    view = (positions - camera.transform[:3, 3]) @ np.linalg.inv(camera.transform[:3, :3]).T
    return np.asarray((view[..., :2] / (-view[..., 2:] * _slope(camera)) + 1) / 2 * SIZE)


def _find_motion_error(
    frame: RenderedFrame, camera: sv.Camera, previous: sv.Camera, steps: Mapping[int, NDArray[Any]] | None = None
) -> tuple[float, float]:
    """The largest error of motion vectors, and the largest of them that instances make, in pixels.

    steps: where points of instances, by their rows, were in the last frame: (4, 4), world from world.
    """
    depth, motion = frame["depth"][..., 0].astype(np.float64), frame["motion_vectors"].astype(np.float64)
    there = depth > 0
    columns, rows = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    ndc = 2 * np.stack([columns, rows], axis=-1) / SIZE - 1
    along = np.concatenate([ndc * _slope(camera), np.full((*depth.shape, 1), -1.0)], axis=-1)
    distance = camera.near / np.where(there, depth, 1.0)[..., None]
    world = transform_points(camera.transform, distance * along)
    was = world.copy()
    for row, step in (steps or {}).items():
        here = there & (frame["gbuffer_surface"][..., 1] == row)
        was[here] = transform_points(step, world[here])
    expected = _project(previous, was) - _project(camera, world)
    moved = np.linalg.norm(_project(previous, was) - _project(previous, world), axis=-1)[there].max()
    return float(np.abs(motion * SIZE - expected)[there].max()), float(moved)


def _turned(transform: NDArray[Any], random: np.random.Generator, angle: float, shift: float) -> NDArray[Any]:
    """The transform turned about its own place, grown or shrunk, and moved, all by chance."""
    result = transform.copy()
    axes, _ = np.linalg.qr(np.eye(3) + random.uniform(-angle, angle, (3, 3)))
    result[:3, :3] = axes * np.sign(np.diag(axes)) @ result[:3, :3] * random.uniform(0.95, 1.05)
    result[:3, 3] += random.uniform(-shift, shift, 3)
    return result


def measure_instance_motion(device: Device) -> Iterator[Measurement]:
    """Things that move, turn and grow before a camera that does so too."""
    random = np.random.default_rng(4)
    scene = sv.Scene(sv.Instance(mesh=shapes.quad((0, 0, -2), (9, 0, 0), (0, 9, 0)), material=matte(0.5)))
    meshes = (shapes.sphere(0.4, 12), shapes.box((-0.4, -0.3, -0.2), (0.4, 0.3, 0.2)))
    places = [place(at=(x, y, 0)) for x in (-1, 0, 1) for y in (-0.5, 0.5)]
    moving = [
        scene.add(sv.Instance(mesh=meshes[i % 2], material=matte(0.5), transform=at)) for i, at in enumerate(places)
    ]
    camera = sv.Camera.look_at((0, 0, 3), (0, 0, 0), vertical_fov=1.0)
    worst, most = 0.0, math.inf
    with make_renderer(device, scene, SIZE, **OFF) as renderer:
        renderer.render(camera)
        for _ in range(4):
            before, previous = {instance: instance.transform for instance in moving}, camera
            for instance in moving:
                instance.transform = _turned(instance.transform, random, 0.2, 0.2)
            pose = camera.transform.copy()
            pose[:3, 3] += random.uniform(-0.1, 0.1, 3)
            camera = sv.Camera(transform=pose, vertical_fov=camera.vertical_fov * random.uniform(0.95, 1.05))
            frame = renderer.render(camera)
            steps = {
                row: before[instance] @ np.linalg.inv(instance.transform)
                for row, instance in renderer.binder.instances.items() if instance in before
            }  # fmt: skip
            error, moved = _find_motion_error(frame, camera, previous, steps)
            worst, most = max(worst, error), min(most, moved)
    note = f"instances move by up to {most:.1f} pixels"
    yield Measurement(INSTANCE_MOTION, worst if most > 2 else math.inf, _MOST, "of a pixel", note)


# ---- culling ----------------------------------------------------------------------------------------


def _walled_scene(random: np.random.Generator) -> sv.Scene:
    """Things of all sizes between walls that hide them; half of them stick in walls."""
    scene, walls = sv.Scene(), 30
    box, meshes = shapes.box(), (shapes.sphere(0.5, 8), shapes.box(), shapes.quad((0, 0, 0), (0.5, 0, 0), (0, 0.5, 0)))
    hosts = []
    for index in range(280):
        size = random.uniform((5, 5, 0.1), (9, 9, 0.3)) if index < walls else np.exp(random.uniform(-3, 0.3, 3))
        axes, _ = np.linalg.qr(random.normal(size=(3, 3)))
        transform = np.eye(4)
        transform[:3, :3] = axes @ np.diag(size * random.choice((-1, 1), 3))
        transform[:3, 3] = random.uniform(-7, 7, 3)
        if index < walls:
            hosts.append(transform)
        elif index % 2:
            transform[:3, 3] = (hosts[random.integers(walls)] @ (*random.uniform(-0.5, 0.5, 3), 1))[:3]
        material = matte(random.uniform(0.2, 0.8, 3), double_sided=bool(index % 3 == 0))
        mesh = box if index < walls else meshes[index % 3]
        scene.add(sv.Instance(mesh=mesh, material=material, transform=transform))
    return scene


def _see(renderer: Renderer, camera: sv.Camera) -> list[NDArray[Any]]:
    frame = renderer.render(camera)
    return [frame[name].copy() for name in _IMAGES]


def measure_culling(device: Device, frame_count: int = 24) -> Iterator[Measurement]:
    """A camera's path among walls, with a cut and with things that move: each pixel is as when all is drawn."""
    random = np.random.default_rng(8)
    scene = _walled_scene(random)
    instances = list(scene.instances)
    off = {**OFF, "jitter": True}
    wrong, culled = 0, dict.fromkeys(_CULLED, 0)
    eye, target = random.uniform(-9, 9, 3), random.uniform(-3, 3, 3)
    with (
        make_renderer(device, scene, SIZE, **off) as renderer,
        make_renderer(device, scene, SIZE, frustum_culling=False, occlusion_culling=False, **off) as plain,
    ):
        for number in range(frame_count):
            eye, target = (at + random.uniform(-0.2, 0.2, 3) for at in (eye, target))
            if number % 7 == 6:  # a cut: what was visible last frame means nothing
                eye, target = random.uniform(-9, 9, 3), random.uniform(-3, 3, 3)
            camera = sv.Camera.look_at(eye, target, vertical_fov=random.uniform(1.0, 1.6))
            for moved in random.choice(np.array(instances, object), 5):
                moved.transform = _turned(moved.transform, random, 0.3, 0.4)
            found, expected = _see(renderer, camera), _see(plain, camera)
            differ = [(ours != theirs).any(axis=-1) for ours, theirs in zip(found, expected, strict=True)]
            wrong += int(np.any(differ, axis=0).sum())
            for name in _CULLED:
                culled[name] += int(renderer[f"gbuffer/{name}"])
    note = ", ".join(f"{count} {name}" for name, count in culled.items())
    worked = min(culled.values()) > frame_count
    pixels = frame_count * SIZE[0] * SIZE[1]
    yield Measurement(CULLING, float(wrong) if worked else math.inf, 0.0, f"of {pixels:,} pixels differ", note)
