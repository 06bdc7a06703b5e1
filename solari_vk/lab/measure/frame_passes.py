"""How much of the realtime frame is measured; time and rays of a frame by pass, and the frame against bare rays."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from solari_vk.bound.binder import SceneBinder
from solari_vk.gpu.device.device import Device
from solari_vk.lab.measure.bare_rays import BarePaths
from solari_vk.lab.measure.figures import device_seconds, warm
from solari_vk.renderers.renderer import Renderer
from solari_vk.scene.model import Camera
from solari_vk.settings import Settings

Size = tuple[int, int]


@dataclass(frozen=True)
class Plan:
    """Picture sizes and counts for one run of `solari-vk bench frame`."""

    sizes: tuple[Size, ...] = ((256, 256), (640, 360))
    frames: int = 6
    warm_up_frames: int = 10
    seconds: float = 1.0
    """The time of each warm-up."""
    cold_start: bool = True
    host_frames: int = 200
    growth_size: Size = (128, 128)
    growth_frames: int = 5
    sides: tuple[int, ...] = (128, 256, 512)
    triangles: tuple[int, ...] = (1_000, 10_000, 100_000, 1_000_000)
    lights: tuple[int, ...] = (8, 100, 1_000, 10_000, 100_000)
    instances: tuple[int, ...] = (100, 1_000, 10_000)


SOFTWARE = Plan()
GPU = Plan(
    sizes=((1920, 1080), (3840, 2160)),
    frames=40,
    growth_size=(1280, 720),
    growth_frames=40,
    sides=(256, 512, 1024, 2048, 4096),
    triangles=(1_000, 10_000, 100_000, 1_000_000, 10_000_000, 30_000_000),
    lights=(8, 1_000, 100_000, 1_000_000),
    instances=(100, 10_000, 100_000, 1_000_000),
)
QUICK = Plan(
    sizes=((16, 16),),
    frames=2,
    warm_up_frames=1,
    seconds=0.0,
    cold_start=False,
    host_frames=10,
    growth_size=(16, 16),
    growth_frames=2,
    sides=(16, 32),
    triangles=(100, 1_000),
    lights=(8, 1_000),
    instances=(10, 100),
)


def plan_for(device: Device, *, quick: bool) -> Plan:
    """The plan for a device: large pictures and scenes for a GPU, small ones for a software device."""
    if quick:
        return QUICK
    return SOFTWARE if device.properties.kind == "cpu" else GPU


def frame_times(
    renderer: Renderer, camera: Camera, warm_up: int, frames: int, warm_seconds: float = 0.0
) -> dict[str, float]:
    """Milliseconds of each pass, medians over frames after a warm-up; "frame" is the time from call to end."""
    spent: dict[str, list[float]] = defaultdict(list)
    # Also fills cells and reservoirs, whose passes cost little in first frames.
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
    with Renderer(device, binder, size, settings, count_rays=True) as renderer:
        for _ in range(warm_up):
            renderer.render(camera)
        before = renderer["ray_counts"].astype(np.int64)
        for _ in range(frames):
            renderer.render(camera)
        counts = (renderer["ray_counts"].astype(np.int64) - before) % (1 << 32)  # the counters wrap
        per_pixel = counts / (frames * size[0] * size[1])
        return dict(zip(renderer.counted_passes, per_pixel.tolist(), strict=False))


def against_bare_rays(renderer: Renderer, camera: Camera, rays: float, rounds: int) -> tuple[float, float]:
    """(time of a frame / time of as many bare rays, millions of bare rays a second), (NaN, NaN) where the camera sees
    too little to measure. rays: the number of rays in a frame.

    Both are measured in turns, so that other work of the machine slows both. Only rays that start at surfaces count, as
    those of a rasterised frame do: camera rays, which are faster, are measured alone and subtracted.
    """
    paths = []
    first_rays = []
    frames = []
    with BarePaths(renderer.device, renderer.binder, camera, renderer.size) as bare:
        bare.run(0)
        for index in range(1, rounds + 1):
            paths.append(bare.run(index))
            first_rays.append(bare.run(index, bounces=0))
            frames.append(device_seconds(renderer.device, lambda: renderer.render(camera)))
    # Without the camera rays: rays that start at surfaces, and their time.
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
