"""Time and rays of a frame by pass, and the frame and the path tracer against bare rays."""

from __future__ import annotations

import math
from collections import defaultdict

import numpy as np

from solari_vk.bound.binder import SceneBinder
from solari_vk.gpu.device.device import Device
from solari_vk.lab.measure.bare_rays import BarePaths
from solari_vk.lab.measure.timing import device_seconds, warm
from solari_vk.renderers.renderer import Renderer
from solari_vk.scene.model import Camera
from solari_vk.settings import Settings


def frame_times(
    renderer: Renderer, camera: Camera, warm_up: int, frames: int, warm_seconds: float = 0.0
) -> dict[str, float]:
    """Milliseconds of each pass, medians over frames after a warm-up; "frame" is the time from call to end."""
    spent: dict[str, list[float]] = defaultdict(list)
    warm(renderer.device, lambda: renderer.render(camera), warm_up, warm_seconds)
    for _ in range(frames):
        spent["frame"].append(1e3 * device_seconds(renderer.device, lambda: renderer.render(camera)))
        for name, value in renderer.timings.items():
            spent[name].append(value)
    return {name: float(np.median(values)) for name, values in spent.items()}


def count_rays(
    device: Device,
    binder: SceneBinder,
    camera: Camera,
    size: tuple[int, int],
    warm_up: int,
    frames: int,
    settings: Settings | None = None,
) -> dict[str, float]:
    """Rays per pixel of a frame by pass, after a warm-up that fills cells and reservoirs."""
    renderer = Renderer(device, binder, size, settings, count_rays=True)
    with renderer:
        for _ in range(warm_up):
            renderer.render(camera)
        before = renderer["ray_counts"].astype(np.int64)
        for _ in range(frames):
            renderer.render(camera)
        counts = (renderer["ray_counts"].astype(np.int64) - before) % (1 << 32)
        per_pixel = counts / (frames * size[0] * size[1])
        return dict(zip(renderer.counted_passes, per_pixel.tolist(), strict=False))


def against_bare_rays(renderer: Renderer, camera: Camera, rays: float, rounds: int) -> tuple[float, float]:
    """(time of a frame / time of as many bare rays, millions of bare rays a second), (NaN, NaN) where the camera sees
    too little to measure. rays: the number of rays in a frame.

    Both are measured in turns, so that other work of the machine slows both. Only rays that start at surfaces count, as
    those of a rasterised frame do: camera rays, which are faster, are measured alone and subtracted.
    """
    paths, first_rays, frames = [], [], []
    with BarePaths(renderer.device, renderer.binder, camera, renderer.size) as bare:
        bare.run(0)
        for index in range(1, rounds + 1):
            paths.append(bare.run(index))
            first_rays.append(bare.run(index, bounces=0))
            frames.append(device_seconds(renderer.device, lambda: renderer.render(camera)))
    spent, traced = (np.median(paths, axis=0) - np.median(first_rays, axis=0)).tolist()
    if not (spent > 0 and traced > 0):
        return math.nan, math.nan
    return float(np.median(frames)) * traced / spent / rays, traced / spent / 1e6


def streamed_time(renderer: Renderer, camera: Camera, frames: int) -> float:
    """Milliseconds a frame when frames are submitted without waiting for each."""

    def render() -> None:
        for _ in range(frames):
            renderer.render(camera)

    return 1e3 * device_seconds(renderer.device, render) / frames
