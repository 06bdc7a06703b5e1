"""Direct light by ReSTIR DI: a Cornell box in light, penumbra and shadow, and lights that are added and removed."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

import solari_vk as sv
from solari_vk.conformance.realtime import DIRECT as DIRECT_PASSES
from solari_vk.conformance.realtime import (
    JITTER_PERIOD,
    SPLIT,
    Effort,
    Image,
    add_up,
    make_renderer,
    measure_mean,
    measure_picture_tiles,
    run_pictures,
    trace,
)
from solari_vk.conformance.rules import SUITE, Measurement, Rule
from solari_vk.gpu.device.device import Device
from solari_vk.measure.replication import replicate
from solari_vk.rendered import RenderedFrame
from solari_vk.scene import shapes
from solari_vk.scene.builtin import cornell_box, lamp, matte, place
from solari_vk.scene.matrices import transform_directions

_DI = (SUITE, "ReSTIR DI")
DIRECT = Rule("direct light of a Cornell box", *_DI)
SIXTEENTHS = Rule("direct light of a Cornell box in each of 4 x 4 tiles", *_DI)
LIT = Rule("direct light where all of the lamp is seen", *_DI)
PENUMBRA = Rule("direct light where part of the lamp is seen", *_DI)
SHADOW = Rule("no direct light where nothing of the lamp is seen", *_DI)
CHANGES = Rule("adding and removing lights leaves the others' light unchanged", *_DI)
# Passes and settings for frames that contain only direct light.
ALONE: dict[str, Any] = {
    "passes": DIRECT_PASSES, **SPLIT, "gi": False, "specular": False, "world_cache": False,
}  # fmt: skip
_SHARE_RAYS = 64  # pairs of a point in the pixel and one on the lamp


class Profile(NamedTuple):
    """The picture's width and height in pixels, the effort of the measurement, and the bars."""

    side: int
    effort: Effort
    bars: dict[Rule, float]


_BARS = {DIRECT: 0.01, SIXTEENTHS: 0.05, LIT: 0.01, PENUMBRA: 0.02, SHADOW: 0.005}
_FULL_BARS = {**_BARS, DIRECT: 0.005, PENUMBRA: 0.01}
FAST = Profile(64, Effort(16, 24, 3 * JITTER_PERIOD, 2048), _BARS)
FULL = Profile(96, Effort(16, 24, 4 * JITTER_PERIOD, 2048), _FULL_BARS)


def read_direct(frame: RenderedFrame) -> Image:
    """The reflected direct light of a frame, (h, w, 3)."""
    return add_up(frame, "di_diffuse", "di_specular")


def find_lit_share(device: Device, scene: sv.Scene, side: int) -> Image:
    """How much of the lamp a pixel's surface sees (side, side), by rays; NaN where it faces away from it."""
    light = next(instance for instance in scene if instance.name == "lamp").mesh.positions.astype(np.float64)
    low, high = light.min(axis=0), light.max(axis=0)
    random = np.random.default_rng(0)
    camera = scene.camera
    slope = math.tan(camera.vertical_fov / 2) * np.array((1.0, -1.0))
    pixels = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1)[:, :, None]
    ndc = 2 * (pixels + random.random((side, side, _SHARE_RAYS, 2))) / side - 1
    view = np.concatenate([ndc * slope, np.full((*ndc.shape[:3], 1), -1.0)], axis=-1)
    along = transform_directions(camera.transform, view)
    with sv.RayTracer(device, scene) as rays:
        hits = rays.trace(camera.transform[:3, 3], along)
        origins = hits["position"] + 1e-4 * hits["normal"]
        to_light = random.uniform(low, high, (*ndc.shape[:3], 3)) - origins
        facing = np.isfinite(hits["t"]) & ((to_light * hits["normal"]).sum(axis=-1) > 1e-2)
        seen = np.isinf(rays.trace(origins, to_light, t_max=1 - 1e-4, any_hit=True)["t"])
    with np.errstate(invalid="ignore"):
        return np.asarray((facing & seen).sum(axis=-1) / facing.sum(axis=-1))


def trace_direct(device: Device, scene: sv.Scene, samples: int, side: int) -> tuple[Image, Image]:
    """The path tracer's picture (side, side, 3) of one bounce, and which pixels (side, side) show no part of a lamp.

    Pixels at a lamp's edges are made black, because there the 32 jitter positions of the realtime frame cover a few per
    cent more of the lamp than the whole pixel does.
    """
    one, none = (trace(device, scene, samples, (side, side), max_bounces=count) for count in (1, 0))
    shown = (none == 0).all(axis=-1)
    return one * shown[..., None], shown


def observe_direct(device: Device, scene: sv.Scene, side: int, effort: Effort, **settings: Any) -> Image:
    """Direct light of independent runs (runs, side, side, 3)."""
    with make_renderer(device, scene, (side, side), **ALONE, **settings) as renderer:
        return run_pictures(renderer, scene.camera, effort, read_direct)


def measure_direct(device: Device, profile: Profile = FAST) -> Iterator[Measurement]:
    """Compares direct light with one bounce of the path tracer: in all pixels, and by the visible share of the lamp."""
    side, effort, bars = profile
    scene = cornell_box()
    expected, shown = trace_direct(device, scene, effort.samples, side)
    found = observe_direct(device, scene, side, effort) * shown[..., None]
    yield measure_mean(DIRECT, found, expected, bars[DIRECT], effort)
    yield measure_picture_tiles(SIXTEENTHS, found, expected, bars[SIXTEENTHS], effort)
    share = np.where(shown, find_lit_share(device, scene, side), np.nan)
    for rule, pixels in ((LIT, share == 1), (PENUMBRA, (share > 0) & (share < 1))):
        yield measure_mean(rule, found[:, pixels], expected[pixels], bars[rule], effort)
    dark = share == 0
    left = float(found[:, dark].mean() / expected.mean()) if dark.sum() > 16 else math.inf
    yield Measurement(SHADOW, left, bars[SHADOW], f"of the picture's light, {effort}")


# ---- lights that are added and removed --------------------------------------------------------------


_LAMPS, _BESIDE = 3, 3.0  # the number of lamps, and the distance between them in meters
_AFTER = 3  # number of frames measured after a change
# In a picture this small, the default radius of 30 pixels would make all pixels share a few samples.
_STEADY: dict[str, Any] = {"di_spatial_radius": 4.0, "di_candidates": 32, "di_confidence_cap": 4.0}


def _row_of_lamps() -> sv.Scene:
    """Lamps in a row over a floor. They are so far apart that each one lights only its third of the picture."""
    ground = sv.Instance(mesh=shapes.quad((0, 0, 0), (0, 0, 9), (9, 0, 0)), material=matte(0.5), name="floor")
    half_height = math.atan(_BESIDE / 2 / 6)
    camera = sv.Camera.look_at((0, 6, 0), (0, 0, 0), up=(0, 0, -1), vertical_fov=2 * half_height)
    scene, shape = sv.Scene(ground, camera), shapes.quad((0, 0, 0), (0.2, 0, 0), (0, 0, 0.2))
    for i in range(_LAMPS):
        at = (_BESIDE * (i - (_LAMPS - 1) / 2), 1.0, 0)
        scene.add(sv.Instance(mesh=shape, material=lamp(9.0), transform=place(at=at), name=f"lamp {i}"))
    return scene


def _thirds(picture: Image) -> Image:
    """The mean light beneath each lamp, (3,)."""
    return np.array([part.mean() for part in np.split(picture, _LAMPS, axis=1)])


def measure_changes(device: Device, full: bool = False) -> Iterator[Measurement]:
    """The first of three lamps is removed, which changes the indices of the others, and then added as the last. After
    each change the next frames are as bright beneath each lamp as the path tracer's, and keep no light of a lamp that
    was removed."""
    side, runs, bar = (48, 48, 0.02) if full else (24, 32, 0.025)
    scene, size = _row_of_lamps(), (_LAMPS * side, side)
    first = next(instance for instance in scene if instance.name == "lamp 0")
    all_on = _thirds(trace(device, scene, 1024, size, max_bounces=1))
    scene.remove(first)
    one_gone = _thirds(trace(device, scene, 1024, size, max_bounces=1))
    scene.add(first)
    with make_renderer(device, scene, size, **_STEADY, **ALONE) as renderer:

        def look(frames: int) -> Image:
            seen = [_thirds(read_direct(renderer.render(scene.camera))) for _ in range(frames)]
            return np.asarray(np.mean(seen, axis=0))

        def observe() -> Image:
            look(12)
            scene.remove(first)
            gone = look(_AFTER)
            scene.add(first)
            return np.stack([gone - one_gone, look(_AFTER) - all_on]) / all_on

        found = replicate(renderer, runs, observe)
    made = {}
    for case, third in np.ndindex(2, _LAMPS):
        where = f"beneath lamp {third}, the first one {('gone', 'back')[case]}"
        made[where] = measure_mean(CHANGES, 1 + found[:, case, third, None], 1.0, bar, Effort(runs, 12, _AFTER))
    where, worst = max(made.items(), key=lambda item: item[1].measured)
    yield dataclasses.replace(worst, note=f"{where}: {worst.note}")
