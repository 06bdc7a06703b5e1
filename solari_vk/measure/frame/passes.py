"""Time and rays of a frame by pass, and the frame and the path tracer against bare rays."""

from __future__ import annotations

import math
import time
from collections import defaultdict

import numpy as np

from solari_vk.bound.binder import SceneBinder
from solari_vk.gpu.device.device import Device
from solari_vk.measure.bare_rays import BarePaths
from solari_vk.measure.timing import device_seconds, warm
from solari_vk.reference import PathTracer
from solari_vk.renderer import Renderer
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
    device: Device, binder: SceneBinder, camera: Camera, size: tuple[int, int], warm_up: int, frames: int,
    settings: Settings | None = None,
) -> dict[str, float]:  # fmt: skip
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


def path_tracer_speed(
    device: Device, binder: SceneBinder, camera: Camera, size: tuple[int, int], total: float
) -> tuple[float, float, float]:
    """Samples a second of the path tracer, its rays a second, and bare rays a second that start at surfaces.

    The last is NaN where they are too few to measure.
    The path tracer and the bare rays are measured in turns for `total` seconds.
    """
    found: list[list[float]] = []
    bare_times, first_times = [], []
    with PathTracer(device, binder, size) as tracer, BarePaths(device, binder, camera, size) as bare:

        def refine() -> None:
            for _ in range(4):
                tracer.advance(camera)

        warm(device, refine, 4, total / 4)  # the path tracer adapts the size of its dispatches
        until = time.perf_counter() + total
        while len(found) < 2 or time.perf_counter() < until:
            before = np.array((tracer.samples * size[0] * size[1], tracer.rays))
            spent = device_seconds(device, refine)
            found.append([spent, *(np.array((tracer.samples * size[0] * size[1], tracer.rays)) - before)])
            bare_times.append(bare.run(len(found)))
            first_times.append(bare.run(len(found), bounces=0))
    spent, samples, rays = np.sum(found, axis=0)
    bare_seconds, bare_rays = np.sum(bare_times, axis=0) - np.sum(first_times, axis=0)
    bare_rate = bare_rays / bare_seconds if min(bare_seconds, bare_rays) > 0 else math.nan
    return samples / spent, rays / spent, bare_rate
