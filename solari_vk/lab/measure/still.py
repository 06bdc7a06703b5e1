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
from solari_vk.lab.measure.scenes import from_file
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
        self.renderer = PathTracer(device, scene, size, seed=seed)
        self._camera = camera
        self._denoise = denoise

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
        self.renderer = Renderer(device, scene, size, seed=seed)
        self._camera = camera
        self._mean = mean
        self.begin()

    def begin(self) -> None:
        self.renderer.reset()
        self._means = FrameAccumulator(self.renderer)
        self._frames = 0

    def refine(self, count: int) -> None:
        """Render until there are `count` frames, after the warm-up if there is one, and wait for them."""
        warm_up = WARM_UP if self._mean else 0
        while self._frames < count + warm_up:
            self.renderer.render(self._camera)
            self._frames += 1
            if self._mean and self._frames > warm_up:
                self._means.add()
        self.renderer["radiance"]

    def picture(self) -> NDArray[np.float32]:
        return self._means["radiance"] if self._mean else self.renderer["radiance"]


OIDN = "path tracer, OIDN"
METHODS: dict[str, Callable[..., PathTraced | Realtime]] = {
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
    each of the two references. Other arguments are those of `measuring`."""
    head = ("scene", *(cell for method in METHODS for cell in (method, "first")))
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
    methods = [method for method in METHODS if oidn.is_installed() or method != OIDN]
    truths: list[NDArray[np.float32]] = []
    first: dict[str, float] = {}
    reached: dict[str, list[tuple[float, int] | None]] = {method: [] for method in methods}
    for seed in range(RUNS):
        for method, results in reached.items():
            if None in results:
                continue  # `limit` was too few for it
            started = time.perf_counter()
            pictures = METHODS[method](device, scene, size, camera, seed)
            with pictures.renderer:
                # The first picture loads and compiles; its time is a column of its own.
                pictures.refine(1)
                first.setdefault(method, time.perf_counter() - started)
                truths = truths or _truths(device, scene, size, camera, samples)
                # The first call loads OIDN, and its time must not count.
                pictures.picture()
                pictures.begin()
                results.append(_reach(pictures, truths, error, limit))
    for method in METHODS:
        if method in reached:
            yield from (_text(reached[method], limit), f"{first[method]:.1f}")
        else:
            yield from ("", "")


def _text(results: Sequence[tuple[float, int] | None], limit: int) -> str:
    """The cell of a method's runs: seconds, and samples or frames."""
    met = [result for result in results if result is not None]
    if len(met) < len(results):
        return f"more than {limit}"
    seconds, count = np.median(met, axis=0)
    return f"{seconds:.2f} ({count:.0f})"


def _truths(
    device: Device, scene: Scene, size: tuple[int, int], camera: Camera, samples: int
) -> list[NDArray[np.float32]]:
    """Two pictures with independent noise."""
    pictures = []
    # Seeds that no run has, so that references share no noise with what is measured by them.
    for seed in (RUNS, RUNS + 1):
        with PathTracer(device, scene, size, seed=seed) as tracer:
            pictures.append(tracer.render(camera, samples=samples)["radiance"])
    return pictures


def _reach(
    pictures: PathTraced | Realtime, truths: Sequence[NDArray[np.float32]], error: float, limit: int
) -> tuple[float, int] | None:
    """Seconds and samples until the error is reached; None if it takes more than `limit` samples."""
    seconds = 0.0
    count = 1
    while count <= limit:
        begun = time.perf_counter()
        pictures.refine(count)
        seconds += time.perf_counter() - begun
        begun = time.perf_counter()
        picture = pictures.picture()
        # Denoising is a part of the last picture only: earlier ones are made to know when to stop.
        finished = seconds + time.perf_counter() - begun
        if true_relative_mse(picture, *truths) <= error:
            return finished, count
        # The next picture goes on from this one.
        count *= 2
    return None
