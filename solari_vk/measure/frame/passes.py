"""Time and rays of a frame by pass, and how much of it bare ray queries would take."""

from __future__ import annotations

import math
import os
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Frame, Pass, Stage
from solari_vk.renderer import Renderer
from solari_vk.scene.binder import SceneBinder
from solari_vk.scene.model import Camera
from solari_vk.scene.view import write_view

BOUNCES = 4  # of the bare kernel's paths


@contextmanager
def every_barrier() -> Iterator[None]:
    """Frames that are made meanwhile wait between all passes: without, those that need not wait for each other
    overlap, and one is charged with the other's time."""
    before = os.environ.get("SOLARI_VK_BARRIERS")
    os.environ["SOLARI_VK_BARRIERS"] = "all"
    try:
        yield
    finally:
        del os.environ["SOLARI_VK_BARRIERS"]
        if before is not None:
            os.environ["SOLARI_VK_BARRIERS"] = before


def timed(device: Device, work: Callable[[], object]) -> float:
    """Milliseconds until the device is done."""
    device.wait_idle()
    started = time.perf_counter()
    work()
    device.wait_idle()
    return (time.perf_counter() - started) * 1e3


def frame_times(renderer: Renderer, camera: Camera, warm_up: int, frames: int) -> dict[str, float]:
    """Milliseconds of each pass, medians of frames after some that warm up; "frame" is from call to done."""
    spent: dict[str, list[float]] = defaultdict(list)
    for index in range(warm_up + frames):
        whole = timed(renderer.device, lambda: renderer.render(camera))
        if index >= warm_up:
            spent["frame"].append(whole)
            for name, value in renderer.timings.items():
                spent[name].append(value)
    return {name: float(np.median(values)) for name, values in spent.items()}


def count_rays(
    device: Device, binder: SceneBinder, camera: Camera, size: tuple[int, int], warm_up: int, frames: int
) -> dict[str, float]:
    """Rays per pixel of a frame by pass, once cells and reservoirs are filled."""
    renderer = Renderer(device, binder, size, count_rays=True)
    with renderer:
        for _ in range(warm_up):
            renderer.render(camera)
        before = renderer["ray_counts"].astype(np.int64)
        for _ in range(frames):
            renderer.render(camera)
        counts = (renderer["ray_counts"].astype(np.int64) - before) % (1 << 32)
        per_pixel = counts / (frames * size[0] * size[1])
        return dict(zip(renderer.counted_passes, per_pixel.tolist(), strict=False))


class BareKernel:
    """Rays and nothing else, over a renderer's scene: paths from the camera on, unshaded. A context manager."""

    def __init__(self, renderer: Renderer, camera: Camera) -> None:
        size = renderer.size
        self._device = renderer.device
        stage = Stage("bench", buffers={"ray_count": size[0] * size[1]}, passes=[Pass("bench/rays", threads=size)])
        self._frame = Frame(renderer.device, [stage], external=renderer.binder.resources)
        write_view(self._frame.uniforms, camera, size, size[1])

    def run(self, index: int, bounces: int) -> tuple[float, int]:
        """Milliseconds and rays of paths that bounce so often."""
        self._frame.uniforms["sample_index"] = index
        self._frame.uniforms["max_bounces"] = bounces
        spent = timed(self._device, self._frame.submit)
        return spent, int(self._frame["ray_count"].sum(dtype=np.uint64))

    def __enter__(self) -> BareKernel:
        return self

    def __exit__(self, *_: object) -> None:
        self._frame.close()


def against_bare_rays(renderer: Renderer, camera: Camera, rays: float, rounds: int) -> tuple[float, float]:
    """The frame's time over what bare ray queries take for so many rays, and these in millions a second; in turns, so
    that what else the machine does slows both. NaN where the camera sees too little to tell.

    Only rays that leave surfaces count, as all of a rasterised frame's do: the camera's, which are faster, above all
    where they meet nothing, are measured alone and taken off.
    """
    paths, first_rays, frames = [], [], []
    with BareKernel(renderer, camera) as bare:
        bare.run(0, BOUNCES)
        for index in range(1, rounds + 1):
            paths.append(bare.run(index, BOUNCES))
            first_rays.append(bare.run(index, 0))
            frames.append(timed(renderer.device, lambda: renderer.render(camera)))
    spent, traced = (np.median(paths, axis=0) - np.median(first_rays, axis=0)).tolist()
    if not (spent > 0 and traced > 0):
        return math.nan, math.nan
    return float(np.median(frames)) * traced / spent / rays, traced / spent / 1e3
