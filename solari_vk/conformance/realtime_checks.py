"""The realtime passes, one after another: G-buffer, ReSTIR DI, world cache, ReSTIR GI, specular GI."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

import solari_vk as sv
from solari_vk.conformance.realtime import add_up, make_renderer, relative_error, run_means, trace
from solari_vk.conformance.rules import SUITE, Measurement, Rule
from solari_vk.gpu.device import Device
from solari_vk.scene import shapes
from solari_vk.scene.builtin import cornell_box, lamp, rgb

_NO_INDEX = 0xFFFFFFFF
RASTER = Rule("raster finds the surfaces that rays find", SUITE, "G-buffer")
MOTION = Rule("motion vectors follow the camera", SUITE, "G-buffer")
DIRECT = Rule("direct light of a Cornell box", SUITE, "ReSTIR DI")
LIST = Rule("the list of active cells is the map's living cells, in its order", SUITE, "World cache")
ONCE = Rule("every key is in one place", SUITE, "World cache")
DEATH = Rule("cells die when nobody asks", SUITE, "World cache")
INDIRECT = Rule("one bounce of indirect light in a Cornell box", SUITE, "ReSTIR GI")
MIRROR = Rule("a mirror in a white room is as bright as its Fresnel term", SUITE, "Specular GI")


def measure_gbuffer(device: Device) -> Iterator[Measurement]:
    """Raster against rays where both see the same object, and motion against the camera's own."""
    scene, size = sv.builtin("sphere_grid", columns=4, rows=2), (64, 48)
    found = {}
    for way in ("raster", "traced"):
        with make_renderer(device, scene, size, gbuffer=way, jitter=False) as renderer:
            frame = renderer.render(scene.camera)
            found[way] = frame["depth"][..., 0].astype(np.float64), frame["gbuffer_surface"][..., 1].copy()
    (depth, instance), (traced_depth, traced_instance) = found.values()
    apart = np.abs(depth - traced_depth) > 1e-3 * np.maximum(traced_depth, 1e-9)
    wrong = float(((instance != traced_instance) | apart).mean())
    yield Measurement(RASTER, wrong, 0.01, "of pixels differ", "edges may")

    near, aspect = scene.camera.near, size[0] / size[1]
    slope = math.tan(scene.camera.vertical_fov / 2) * np.array((aspect, -1.0))
    with make_renderer(device, scene, size, jitter=False) as renderer:
        renderer.render(scene.camera)
        moved = scene.camera.transform.copy()
        moved[:3, 3] += (0.2, -0.1, -0.3)
        frame = renderer.render(sv.Camera(transform=moved, vertical_fov=scene.camera.vertical_fov, near=near))
        motion, depth = frame["motion_vectors"].astype(np.float64), frame["depth"][..., 0].astype(np.float64)
    columns, rows = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
    uv = np.stack([columns / size[0], rows / size[1]], axis=-1)
    distance = near / np.where(depth > 0, depth, 1.0)[..., None]
    view = np.concatenate([(2 * uv - 1) * slope * distance, -distance], axis=-1)
    before = view + np.array((0.2, -0.1, -0.3)) @ moved[:3, :3]
    expected = (before[..., :2] / (-before[..., 2:] * slope) + 1) / 2 - uv
    error = np.abs((motion - expected) * size)[depth > 0].max()
    yield Measurement(MOTION, float(error), 1 / 16, "of a pixel")


def measure_direct(device: Device, observed: int = 24) -> Iterator[Measurement]:
    """What arrives straight from the lamp, against one bounce of the path tracer."""
    scene = cornell_box()
    expected = trace(device, scene, 512, max_bounces=1) - trace(device, scene, 512, max_bounces=0)
    with make_renderer(device, scene, gi=False, specular=False, world_cache=False) as renderer:
        means = run_means(renderer, scene.camera, lambda f: add_up(f, "di_diffuse", "di_specular"), 24, observed)
    error, half_width = relative_error(means, float(expected.mean()))
    yield Measurement(DIRECT, abs(error) + half_width, 0.02, "relative error", f"{error:+.2%} +- {half_width:.2%}")


def measure_world_cache(device: Device) -> Iterator[Measurement]:
    """The hash map's laws, of the map as a frame leaves it."""
    scene = cornell_box()
    with make_renderer(device, scene) as renderer:
        for _ in range(6):
            renderer.render(scene.camera)
        before = renderer["world_cache_checksums"].copy(), renderer["world_cache_life"].copy()
        renderer.render(scene.camera)
        count = int(renderer["world_cache/active_cells"])
        listed = renderer["world_cache_active_cells"][:count]
        living = np.flatnonzero((before[0] != 0) & (before[1] > 0))
        wrong = len(living) if len(living) != count else int((listed != living).sum())
        yield Measurement(LIST, float(wrong if count > 100 else math.inf), 0.0, f"of {count} wrong")
        keys = renderer["world_cache_checksums"]
        keys = keys[keys != 0]
        yield Measurement(ONCE, float(len(keys) - len(np.unique(keys))), 0.0, "twice")
        renderer.settings.gi = renderer.settings.specular = False
        for _ in range(renderer.settings.world_cache_lifetime + 2):
            renderer.render(scene.camera)
        yield Measurement(DEATH, float(renderer["world_cache/active_cells"]), 0.0, "left")


def measure_indirect(device: Device, observed: int = 24) -> Iterator[Measurement]:
    """Without the cache, indirect light is the path tracer's second bounce."""
    scene = cornell_box()
    expected = trace(device, scene, 512, max_bounces=2) - trace(device, scene, 512, max_bounces=1)
    with make_renderer(device, scene, world_cache=False, di=False) as renderer:
        means = run_means(renderer, scene.camera, lambda f: add_up(f, "gi_diffuse", "specular_gi"), 16, observed)
    error, half_width = relative_error(means, float(expected.mean()))
    yield Measurement(INDIRECT, abs(error) + half_width, 0.06, "relative error", f"{error:+.2%} +- {half_width:.2%}")


def measure_mirror(device: Device) -> Iterator[Measurement]:
    """A flat mirror of metal within walls that all emit 1: what it shows is Schlick's Fresnel term."""
    room = sv.Instance(mesh=shapes.box((-4, -4, -4), (4, 4, 4), inward=True), material=lamp(1.0))
    color = np.array((0.9, 0.6, 0.3))
    gold = sv.Material(base_color=rgb(color), metallic=1.0, perceptual_roughness=0.0)
    mirror = sv.Instance(mesh=shapes.quad((0, 0, -2), (3, 0, 0), (0, 3, 0)), material=gold)
    camera = sv.Camera.look_at((0, 0, 0), (0, 0, -2), vertical_fov=1.2)
    size = (24, 24)
    with make_renderer(device, sv.Scene(room, mirror, camera), size, jitter=False) as renderer:
        for _ in range(2):
            frame = renderer.render(camera)
        found = add_up(frame)
    across = (2 * (np.arange(24) + 0.5) / 24 - 1) * math.tan(0.6)
    cosine = 1 / np.sqrt(1 + across[None, :] ** 2 + across[:, None] ** 2)
    expected = color + (1 - color) * (1 - cosine[..., None]) ** 5
    # Of the mean: single pixels also show the faint sheen of the walls.
    error = np.abs(found.mean(axis=(0, 1)) / expected.mean(axis=(0, 1)) - 1).max()
    yield Measurement(MIRROR, float(error), 0.01, "relative error")
