"""Light that pixels reuse (restir=on): the path tracer's mean, less noise, and shadows that don't lag."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

import solari_vk as sv
from solari_vk.conformance.paths_checks import PASSES, PLAIN, SIZE, measure_tiles, observe_paths, trace_centers
from solari_vk.conformance.realtime import Effort, Image, add_up, make_renderer, measure_mean, trace, trace_reflected
from solari_vk.conformance.rules import SUITE, Measurement, Rule
from solari_vk.conformance.specular_checks import metal_gallery
from solari_vk.gpu.device.device import Device
from solari_vk.measure.replication import replicate
from solari_vk.scene.builtin import cornell_box, place

_PATHS = (SUITE, "Paths")
REUSED = Rule("paths whose light pixels reuse have the path tracer's mean", *_PATHS)
REUSED_TILES = Rule("where pixels reuse light, no tile differs from the path tracer's", *_PATHS)
LESS_NOISE = Rule("reuse takes at least a quarter off the variance of a frame", *_PATHS)
NO_LAG = Rule("a frame after a block has jumped, reused light contains little of its old shadow", *_PATHS)
RESTIR: dict[str, Any] = {**PLAIN, "restir": True}
FAST, FULL = Effort(16, 24, 32, 4096), Effort(16, 24, 256, 16384)


def measure_means(
    device: Device, effort: Effort = FAST, scene: sv.Scene | None = None, bar: float = 0.02, **settings: Any
) -> Iterator[Measurement]:  # fmt: skip
    """Against the path tracer, for metals that show a lamp, a sun, gloss and mirrors, or for `scene`.

    Pixels that show a light itself are left out, since the G-buffer rounds emission.
    """
    scene = scene or metal_gallery()
    shows_no_light = trace(device, scene, 64, SIZE, max_bounces=0).max(axis=-1, keepdims=True) == 0
    expected = trace_centers(device, scene, effort.samples) * shows_no_light
    found = observe_paths(device, scene, effort, **{**RESTIR, **settings}) * shows_no_light
    yield measure_mean(REUSED, found, expected, bar, effort)
    yield measure_tiles(REUSED_TILES, found, expected)


def measure_noise(device: Device) -> Iterator[Measurement]:
    """The median of pixels' variances between runs, over the same without reuse, in a Cornell box."""
    scene = cornell_box()
    variance = [
        float(np.median(observe_paths(device, scene, Effort(16, 12, 1), **{**RESTIR, "restir": on}).var(axis=0)))
        for on in (True, False)
    ]
    yield Measurement(LESS_NOISE, variance[0] / variance[1], 0.75, "of the variance without reuse")


def measure_lag(device: Device, runs: int = 24) -> Iterator[Measurement]:
    """How much of the picture from before a jump of a block the first frame after it contains: its projection onto the
    difference of both pictures."""
    scene = cornell_box()
    block = next(instance for instance in scene if instance.name == "short block")
    places = [place(at=(x, 0.15, 0.0)) for x in (0.0, 0.3)]
    pictures = []
    for transform in places:
        block.transform = transform
        pictures.append(trace_reflected(device, scene, 512))
    before, now = pictures
    difference = (before - now) * ((before > 0) & (now > 0))
    with make_renderer(device, scene, SIZE, passes=PASSES, lighting="paths", restir=True) as renderer:

        def observe() -> Image:
            for frame in range(13):
                block.transform = places[frame == 12]
                picture = add_up(renderer.render(scene.camera))
            return np.array(((picture - now) * difference).sum() / (difference**2).sum())

        found = replicate(renderer, runs, observe)
    note = f"+- {2 * found.std() / runs**0.5:.3f}"
    yield Measurement(NO_LAG, abs(float(found.mean())), 0.1, "of the old picture", note)
