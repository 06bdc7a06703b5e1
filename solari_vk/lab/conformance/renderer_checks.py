"""Whole pictures of the program, so that one sees that it works on the driver: a short selection, with known results.

What proves the renderer itself is in the project's tests.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from solari_vk.gpu.device.device import Device
from solari_vk.lab.conformance.outcomes import SUITE, Measurement, Rule
from solari_vk.renderers.path_tracer import PathTracer
from solari_vk.renderers.renderer import Renderer
from solari_vk.scene.builtin import builtin, closed_box
from solari_vk.settings import Settings

_RENDERER = (SUITE, "Renderer")
SERIES = Rule("path-traced light in a closed room is its geometric series", *_RENDERER)
CLOSED = Rule("a realtime frame of a closed room has the light of all bounces", *_RENDERER)
SEED = Rule("a seed gives the same bits of realtime frames", *_RENDERER)
FINITE = Rule("realtime frames of a hall of mirrors are finite", *_RENDERER)
GBUFFER = Rule("rasterized and traced surfaces are the same", *_RENDERER)
SIZE = (32, 32)
SIZE_OF_SEEDS = (96, 64)  # so that what differs in one of thousands of paths is seen
_SETTINGS: dict[str, Any] = {"antialiasing": False, "jitter": False, "world_cache_cells": 1 << 18}


def measure_series(device: Device) -> Iterator[Measurement]:
    """Walls emit light and reflect a share of it: after k bounces the radiance is the sum of the first k + 1 terms."""
    albedo = np.array((0.3, 0.5, 0.7))
    emission = np.array((2.0, 1.0, 0.25))
    bounces = 4
    scene = closed_box()
    scene.materials[0].update(base_color=albedo, emissive=emission)
    with PathTracer(device, scene, SIZE, max_bounces=bounces, lambert=True) as tracer:
        mean = tracer.render(scene.camera, 256)["radiance"].mean(axis=(0, 1), dtype=np.float64)
    expected = emission * sum(albedo**k for k in range(bounces + 1))
    yield Measurement(SERIES, float(np.abs(mean / expected - 1).max()), 0.01, "relative error")


def _frames(
    device: Device, name: str, count: int, seed: int = 0, size: tuple[int, int] = SIZE, **settings: Any
) -> list[dict[str, Any]]:
    scene = closed_box() if name == "closed_box" else builtin(name)
    with Renderer(device, scene, size, Settings(**{**_SETTINGS, **settings}), seed=seed) as renderer:
        frames = []
        for _ in range(count):
            frame = renderer.render(scene.camera)
            # The next frame overwrites the arrays.
            frames.append({name: frame[name].copy() for name in ("radiance", "depth", "shading_normal", "instance_id")})
    return frames


def measure_closed_room(device: Device) -> Iterator[Measurement]:
    """Walls emit 1 and reflect half of the light, so that the radiance is 2."""
    # The first half fills the world cache, which has the light of further bounces.
    settled = _frames(device, "closed_box", 64)[32:]
    mean = np.mean([frame["radiance"].mean(dtype=np.float64) for frame in settled])
    yield Measurement(CLOSED, abs(float(mean) / 2 - 1), 0.05, "relative error")


def measure_frames(device: Device) -> Iterator[Measurement]:
    """Frames with one seed, four times: of a room and, the finite ones, of a hall of mirrors."""
    differ = 0
    for scene in ("cornell_box", "mirror_hall"):
        first, *others = (_frames(device, scene, 4, seed=5, size=SIZE_OF_SEEDS) for _ in range(4))
        pairs = [pair for again in others for pair in zip(first, again, strict=True)]
        differ += sum(a[name].tobytes() != b[name].tobytes() for a, b in pairs for name in a)
    yield Measurement(SEED, float(differ), 0.0, "results differ")
    wrong = sum(int((~np.isfinite(frame["radiance"]) | (frame["radiance"] < 0)).sum()) for frame in first)
    yield Measurement(FINITE, float(wrong), 0.0, "values are not finite, or negative")


def measure_gbuffer(device: Device) -> Iterator[Measurement]:
    """The instances and depths that pixels show, by raster and by rays; at edges they may differ."""
    raster, traced = (_frames(device, "sphere_grid", 1, gbuffer=way)[0] for way in ("raster", "traced"))
    apart = ~np.isclose(raster["depth"], traced["depth"], rtol=1e-3)
    differs = apart | (raster["instance_id"] != traced["instance_id"])
    yield Measurement(GBUFFER, float(differs.mean()), 0.02, "of pixels differ")
