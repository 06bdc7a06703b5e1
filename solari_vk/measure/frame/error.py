"""The error of single frames and of the mean of many, and what they cost, beside the path tracer's.

The mean of many frames is what a user sees, because every denoiser and every eye puts frames together.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.binder import SceneBinder
from solari_vk.gpu.device.device import Device
from solari_vk.measure.frame.passes import count_rays
from solari_vk.measure.report import milliseconds
from solari_vk.output.compare import relative_mse
from solari_vk.reference import PathTracer
from solari_vk.renderer import Renderer
from solari_vk.scene.model import Camera, Scene
from solari_vk.settings import RAW, Settings

Picture = NDArray[np.float64]
HEAD = ("", "one", "mean", "noise of it", "ms", "cpu ms", "rays", "one / PT", "mean / PT", "one / PT, cpu",
        "mean / PT, cpu")  # fmt: skip
NOTE = (
    "relMSE. one: a single frame in the steady state, or a sample a pixel of the path tracer (PT). mean: the mean of "
    "{observed} consecutive frames after {warm_up}, or {observed} samples, averaged over {seeds} runs (PT: four times "
    "as many); noise of it: without what all runs have in common, which is bias. ms, rays a pixel: of a frame or a "
    "sample. / PT: error x time over the path tracer's of this run, with processor time for cpu, which means little on "
    "a GPU."
)


@dataclass(frozen=True)
class Effort:
    """Independent runs, and the frames of each: a warm-up, and those whose mean is measured."""

    seeds: int = 3
    warm_up: int = 24
    observed: int = 32


@dataclass
class Errors:
    """The errors (relMSE) of pictures of independent runs, and what each frame or sample cost."""

    truth: Picture
    singles: list[NDArray[Any]] = field(default_factory=list)
    """Single frames or samples."""
    means: list[Picture] = field(default_factory=list)
    """The mean of the frames of each run."""
    wall: list[float] = field(default_factory=list)
    """Milliseconds of each frame, from call to done."""
    cpu: list[float] = field(default_factory=list)
    """Milliseconds of processor time of each frame in all threads of the process. On a software device other work of
    the machine hardly changes them."""
    rays: float = float("nan")
    """Rays per pixel of a frame."""

    @property
    def one(self) -> float:
        return float(np.mean([relative_mse(picture, self.truth) for picture in self.singles]))

    @property
    def many(self) -> float:
        """The error of the mean of frames, averaged over runs."""
        return float(np.mean([relative_mse(picture, self.truth) for picture in self.means]))

    @property
    def noise(self) -> float:
        """The part of `many` that differs from run to run. The rest is bias, and noise of the reference."""
        if len(self.means) < 2:
            return float("nan")
        off = self.truth - np.mean(self.means, axis=0)
        return sum(relative_mse(picture + off, self.truth) for picture in self.means) / (len(self.means) - 1)

    @property
    def ms(self) -> float:
        return float(np.median(self.wall))

    @property
    def cpu_ms(self) -> float:
        return float(np.median(self.cpu))

    def add_time(self, device: Device, work: Callable[[], Any], pictures: int = 1) -> None:
        """Do some work on an idle device, which makes this many frames or samples, and add its time."""
        device.wait_idle()
        started = time.perf_counter(), time.process_time()
        work()
        device.wait_idle()
        self.wall.append(1e3 * (time.perf_counter() - started[0]) / pictures)
        self.cpu.append(1e3 * (time.process_time() - started[1]) / pictures)


def configurations() -> dict[str, Settings]:
    """The settings whose errors are compared, by name."""
    named = {
        "paths": Settings(), "paths, raw": Settings(**RAW), "paths, raw, restir on": Settings(**RAW, restir=True),
        "split": Settings(lighting="split"), "solari": Settings.preset("solari"),
    }  # fmt: skip
    return {f"{name} (default)" if settings == Settings() else name: settings for name, settings in named.items()}


def reference(device: Device, scene: Scene | SceneBinder, camera: Camera, size: tuple[int, int], samples: int,
              limit: float | None = None) -> tuple[Picture, int]:  # fmt: skip
    """(picture, samples a pixel) of the path tracer with a seed that no measurement uses. limit: seconds."""
    with PathTracer(device, scene, size, seed=1_000_003) as tracer:
        picture = tracer.render(camera, samples=samples, time_limit=limit)["radiance"].astype(np.float64)
        return picture, tracer.samples


def of_path_tracer(
    device: Device, scene: Scene | SceneBinder, camera: Camera, truth: Picture, effort: Effort
) -> Errors:  # fmt: skip
    """The path tracer's errors with one sample, and with as many samples as others have frames.

    It has four times as many runs as others, because its rare bright samples make errors of pictures uncertain.
    """
    found, size = Errors(truth), (truth.shape[1], truth.shape[0])
    with PathTracer(device, scene, size) as tracer:

        def sum_of(samples: int) -> Picture:
            return samples * tracer.render(camera, samples=samples)["radiance"].astype(np.float64)

        before = sum_of(effort.observed)  # a driver may compile here, and dispatches adapt their size
        for _ in range(4 * effort.seeds):
            first, done = tracer.samples + 1, tracer.samples + effort.observed
            found.singles.append(sum_of(first) - before)
            found.add_time(device, lambda: tracer.render(camera, samples=done), done - first)  # noqa: B023
            after = sum_of(done)
            found.means.append((after - before) / effort.observed)
            before = after
        found.rays = tracer.rays / (tracer.samples * size[0] * size[1])
    return found


def of_frames(renderer: Renderer, camera: Camera, truth: Picture, effort: Effort) -> Errors:
    """The errors of single frames in the steady state, and of the mean of the observed frames."""
    found = Errors(truth)
    for seed in range(effort.seeds):
        renderer.seed = seed
        renderer.reset()
        for _ in range(effort.warm_up):
            renderer.render(camera).wait()
        frames = []
        for _ in range(effort.observed):
            found.add_time(renderer.device, lambda: renderer.render(camera))
            frames.append(renderer["radiance"])
        found.singles += frames
        found.means.append(np.mean(frames, axis=0, dtype=np.float64))
    return found


def compare(device: Device, scene: Scene, truth: Picture, effort: Effort) -> Iterator[list[str]]:
    """A row below HEAD for the path tracer and for each of the configurations, as they are measured."""
    binder, size, camera = SceneBinder(device, scene), (truth.shape[1], truth.shape[0]), scene.camera
    try:
        base = of_path_tracer(device, binder, camera, truth, effort)
        yield row("path tracer", base, base)
        for name, settings in configurations().items():
            with Renderer(device, binder, size, settings) as renderer:
                found = of_frames(renderer, camera, truth, effort)
            found.rays = sum(count_rays(device, binder, camera, size, effort.warm_up, 2, settings).values())
            yield row(name, found, base)
    finally:
        binder.destroy()


def row(name: str, found: Errors, base: Errors) -> list[str]:
    """The cells of a row below HEAD."""
    cells = [f"{found.one:.3g}", f"{found.many:.3g}", f"{found.noise:.3g}", milliseconds(found.ms),
             milliseconds(found.cpu_ms), f"{found.rays:.2f}"]  # fmt: skip
    for times in (found.ms / base.ms, found.cpu_ms / base.cpu_ms):
        cells += [f"{found.one / base.one * times:.2f}", f"{found.many / base.many * times:.2f}"]
    return [name, *("" if cell == "nan" else cell for cell in cells)]
