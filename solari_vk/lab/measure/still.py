"""`solari-vk bench still`: which way reaches a clean still picture first on this device."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from solari_vk.gpu.device.device import Device
from solari_vk.lab.measure.report import measuring
from solari_vk.lab.measure.subjects import from_file
from solari_vk.output import oidn
from solari_vk.output.compare import true_relative_mse
from solari_vk.renderers.accumulator import FrameAccumulator
from solari_vk.renderers.path_tracer import PathTracer
from solari_vk.renderers.renderer import Renderer
from solari_vk.scene.builtin import builtin
from solari_vk.scene.model import Camera, Scene

SCENES = ("cornell_box", "sphere_grid", "mirror_hall", "many_lights")
WARM_UP = 16
"""Frames before those whose mean is the picture, as `solari-vk render --mode realtime` has them."""
RUNS = 3
INTRO = (
    "Seconds until the relMSE of a still picture is small enough, against the path tracer: the noise of its two "
    f"pictures cancels out. Ways take turns; medians of {RUNS} runs with different seeds; in brackets the samples or "
    "frames of a pixel, which double until the error is reached. First: seconds until the first sample or frame of the "
    "first run, which load the scene and compile what the driver's cache doesn't have. OIDN runs on the processor. "
    f"Means of frames leave out the first {WARM_UP}. `solari-vk render` without --mode goes by such pages: on graphics "
    "cards realtime frames, on the processor the denoised path tracer.",
)


class PathTraced:
    """Pictures of the path tracer, of more and more samples."""

    def __init__(
        self, device: Device, scene: Scene, size: tuple[int, int], camera: Camera, seed: int, *, denoise: bool
    ) -> None:
        self.renderer, self._camera, self._denoise = PathTracer(device, scene, size, seed=seed), camera, denoise

    def begin(self) -> None:
        self.renderer.reset()

    def refine(self, count: int) -> None:
        """Render until there are `count` samples a pixel, and wait for them."""
        self.renderer.render(self._camera, samples=count, denoise=self._denoise)["raw_radiance"]

    def picture(self) -> NDArray[np.float32]:
        return self.renderer["radiance"]


class Realtime:
    """Pictures of the realtime renderer: the latest frame, or the mean of frames."""

    def __init__(
        self, device: Device, scene: Scene, size: tuple[int, int], camera: Camera, seed: int, *, mean: bool
    ) -> None:
        self.renderer, self._camera, self._mean = Renderer(device, scene, size, seed=seed), camera, mean
        self.begin()

    def begin(self) -> None:
        self.renderer.reset()
        self._means, self._frames = FrameAccumulator(self.renderer), 0

    def refine(self, count: int) -> None:
        """Render until there are `count` frames, after the warm-up if there is one, and wait for them."""
        while self._frames < count + WARM_UP * self._mean:
            self.renderer.render(self._camera)
            self._frames += 1
            if self._mean and self._frames > WARM_UP:
                self._means.add()
        self.renderer["radiance"]

    def picture(self) -> NDArray[np.float32]:
        return self._means["radiance"] if self._mean else self.renderer["radiance"]


OIDN = "path tracer, OIDN"
WAYS: dict[str, Callable[..., PathTraced | Realtime]] = {
    OIDN: partial(PathTraced, denoise=True),
    "path tracer": partial(PathTraced, denoise=False),
    "realtime, mean of frames": partial(Realtime, mean=True),
    "realtime, latest frame": partial(Realtime, mean=False),
}


def run(
    select: str | None,
    files: Sequence[Path],
    scenes: Sequence[str],
    size: tuple[int, int],
    error: float,
    limit: int,
    samples: int,
    markdown: Path | None,
    *,
    rays: str | None = None,
) -> None:
    """Measure and report. error: the relMSE that is enough. limit: the most samples or frames of a picture. samples: of
    each of the two pictures that judge. Other arguments are those of `measuring`."""
    head = ("scene", *(cell for way in WAYS for cell in (way, "first")))
    with measuring(select, rays, markdown, "Still pictures", *INTRO) as (device, report):
        rows = []
        for scene in (*map(builtin, scenes or SCENES), *map(from_file, files)):
            report.progress(scene.name)
            rows.append([scene.name, *_measured(device, scene, size, error, limit, samples)])
        report.table(f"To a relMSE of {error:g}, {size[0]}x{size[1]}", head, rows)


def _measured(
    device: Device, scene: Scene, size: tuple[int, int], error: float, limit: int, samples: int
) -> Iterator[str]:
    """The cells of a scene."""
    camera = scene.camera_for(size[0] / size[1])
    truths, first = list[NDArray[np.float32]](), dict[str, float]()
    reached: dict[str, list[tuple[float, int] | None]] = {way: [] for way in WAYS if oidn.is_installed() or way != OIDN}
    for seed in range(RUNS):
        for way, results in reached.items():
            if None in results:
                continue  # `limit` was too few for it
            begun = time.perf_counter()
            pictures = WAYS[way](device, scene, size, camera, seed)
            with pictures.renderer:
                pictures.refine(1)
                first.setdefault(way, time.perf_counter() - begun)
                truths = truths or _truths(device, scene, size, camera, samples)
                pictures.picture()  # loads OIDN
                pictures.begin()
                results.append(_reach(pictures, truths, error, limit))
    for way in WAYS:
        results = reached.get(way, [])
        met = [result for result in results if result is not None]
        seconds, count = np.median(met, axis=0) if met else (0.0, limit)
        text = "" if not results else f"more than {limit}" if None in results else f"{seconds:.2f} ({count:.0f})"
        yield from (text, f"{first[way]:.1f}" if results else "")


def _truths(
    device: Device, scene: Scene, size: tuple[int, int], camera: Camera, samples: int
) -> list[NDArray[np.float32]]:
    """Two pictures with independent noise."""
    pictures = []
    for seed in (RUNS, RUNS + 1):
        with PathTracer(device, scene, size, seed=seed) as tracer:
            pictures.append(tracer.render(camera, samples=samples)["radiance"])
    return pictures


def _reach(
    pictures: PathTraced | Realtime, truths: Sequence[NDArray[np.float32]], error: float, limit: int
) -> tuple[float, int] | None:
    """Seconds and samples until the error is reached; None if it takes more than `limit` samples."""
    seconds, count = 0.0, 1
    while count <= limit:
        begun = time.perf_counter()
        pictures.refine(count)
        seconds += time.perf_counter() - begun
        begun = time.perf_counter()
        picture = pictures.picture()
        finished = seconds + time.perf_counter() - begun
        if true_relative_mse(picture, *truths) <= error:
            return finished, count
        count *= 2
    return None
