"""The error of single frames and of the mean of many, and what they cost, beside the path tracer's.

The mean of many frames is what a user sees, because every denoiser and every eye puts frames together.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from types import EllipsisType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.gpu.device.device import Device
from solari_vk.measure.frame.reprojection import Movement
from solari_vk.measure.statistics import relative_mse
from solari_vk.reference import PathTracer
from solari_vk.renderer import Renderer
from solari_vk.scene.binder import SceneBinder
from solari_vk.scene.model import Camera, Scene
from solari_vk.settings import RAW, Settings

Picture = NDArray[np.float64]


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

    pixels: NDArray[np.bool_] | EllipsisType = ...
    """The pixels that count."""

    def _of(self, picture: NDArray[Any]) -> float:
        return relative_mse(picture[self.pixels], self.truth[self.pixels])

    @property
    def one(self) -> float:
        return float(np.mean([self._of(picture) for picture in self.singles]))

    @property
    def many(self) -> float:
        """The error of the mean of frames, averaged over runs."""
        return float(np.mean([self._of(picture) for picture in self.means]))

    @property
    def noise(self) -> float:
        """The part of `many` that differs from run to run. The rest is bias, and noise of the reference."""
        if len(self.means) < 2:
            return float("nan")
        middle = np.mean(self.means, axis=0)
        return sum(self._of(self.truth + picture - middle) for picture in self.means) / (len(self.means) - 1)

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


def of_frames(
    renderer: Renderer, camera: Camera, truth: Picture, effort: Effort, movement: Movement | None = None
) -> Errors:
    """The errors of single frames in the steady state, and of the mean of the observed frames.

    With a movement, whose cameras jitter, frames are reprojected, and only the last one of a run counts as single.
    """
    found, settings = Errors(truth, pixels=movement.rough if movement else ...), renderer.settings
    cameras: Sequence[Camera] = movement.cameras if movement else [camera] * (effort.warm_up + effort.observed)
    renderer.settings = replace(settings, jitter=settings.jitter and movement is None)
    for seed in range(effort.seeds):
        renderer.seed = seed
        renderer.reset()
        frames = []
        for index, view in enumerate(cameras):
            if index < effort.warm_up:
                renderer.render(view).wait()
                continue
            found.add_time(renderer.device, lambda: renderer.render(view))  # noqa: B023
            frames.append(renderer["radiance"])
        found.singles += frames[-1:] if movement else frames
        found.means.append(movement.mean(frames) if movement else np.mean(frames, axis=0, dtype=np.float64))
    renderer.settings = settings
    return found
