"""Realtime frames for the suite: small renderers, replicated runs, and their mean against the path tracer's."""

from __future__ import annotations

import statistics
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.gpu.device import Device
from solari_vk.reference import PathTracer
from solari_vk.renderer import RenderedFrame, Renderer
from solari_vk.scene.model import Camera, Scene
from solari_vk.settings import Settings

Image = NDArray[Any]
# Fewer tiles and cells than in use, for speed: no mean hangs on them.
SMALL = {"light_tile_count": 16, "world_cache_cells": 1 << 18}
PARTS = ("di_diffuse", "di_specular", "gi_diffuse", "specular_gi")
# Nothing but surfaces and what is seen of lights, each pixel at its middle.
OFF = {"di": False, "gi": False, "specular": False, "world_cache": False, "jitter": False}
_STUDENT_95 = 2.365  # two-sided, 7 degrees of freedom
RUNS = 8


def make_renderer(
    device: Device, scene: Scene, size: tuple[int, int] = (32, 32), seed: int = 0, **settings: Any
) -> Renderer:
    """A renderer of the suite's settings and these."""
    return Renderer(device, scene, size, Settings(**{**SMALL, **settings}), seed=seed)


def add_up(frame: RenderedFrame, *names: str) -> Image:
    """The sum (h, w, 3) of results."""
    total = np.zeros((1, 1, 3))
    for name in names or PARTS:
        total = total + np.asarray(frame[name], np.float64)[..., :3]
    return total


def trace(device: Device, scene: Scene, samples: int, size: tuple[int, int] = (32, 32), **settings: Any) -> Image:
    """The path tracer's picture (h, w, 3)."""
    tracer = PathTracer(device, scene, size, **settings)
    try:
        return tracer.render(scene.camera, samples=samples).astype(np.float64)
    finally:
        tracer.close()


def run_means(
    renderer: Renderer, camera: Camera, read: Callable[[RenderedFrame], Image], warm_up: int, observed: int
) -> list[float]:
    """The means of what `read` finds, of independent runs."""
    means = []
    for seed in range(RUNS):
        renderer.seed = seed
        renderer.reset()
        for _ in range(warm_up):
            renderer.render(camera)
        means.append(float(np.mean([read(renderer.render(camera)).mean() for _ in range(observed)])))
    return means


def relative_error(means: list[float], expected: float) -> tuple[float, float]:
    """The error of the runs' mean, and the half width of its 95 % interval, relative to what's expected."""
    half_width = _STUDENT_95 * statistics.stdev(means) / RUNS**0.5
    return statistics.fmean(means) / expected - 1, half_width / expected
