"""The error of pictures against the reference, over frames, samples and seconds."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from solari_vk.gpu.device.device import Device
from solari_vk.measure.statistics import relative_mse
from solari_vk.reference import PathTracer
from solari_vk.renderer import Renderer
from solari_vk.scene.model import Scene
from solari_vk.settings import Settings

Picture = NDArray[np.float64]


def reference(device: Device, scene: Scene, size: tuple[int, int], samples: int, limit: float) -> tuple[Picture, int]:
    """(picture, samples a pixel) of the path tracer with a seed that no measurement uses. limit: seconds."""
    with PathTracer(device, scene, size, seed=1_000_003) as tracer:
        picture = tracer.render(scene.camera, samples=samples, time_limit=limit)["radiance"].astype(np.float64)
        return picture, tracer.samples


def realtime_curve(
    device: Device, scene: Scene, size: tuple[int, int], truth: Picture, frames: int, warm_up: int
) -> list[tuple[int, float, float, float]]:
    """(frame, seconds so far, error of that frame, error of the mean of all frames since `warm_up`), at powers of 2."""
    found = []
    total, averaged, seconds = np.zeros_like(truth), 0, 0.0
    with Renderer(device, scene, size, Settings()) as renderer:
        renderer.render(scene.camera)  # a driver may compile in this frame
        device.wait_idle()
        renderer.reset()
        for index in range(1, frames + 1):
            started = time.perf_counter()
            frame = renderer.render(scene.camera)
            device.wait_idle()
            seconds += time.perf_counter() - started
            picture = frame["radiance"].astype(np.float64)
            if index > warm_up:
                total, averaged = total + picture, averaged + 1
            if index & (index - 1) == 0 or index == frames:
                mean = relative_mse(total / averaged, truth) if averaged else float("nan")
                found.append((index, seconds, relative_mse(picture, truth), mean))
    return found


def path_tracer_curve(
    device: Device, scene: Scene, size: tuple[int, int], truth: Picture, seconds: float, max_samples: int
) -> list[tuple[int, float, float]]:
    """(samples a pixel, seconds so far, error) at powers of 2, for up to `seconds` and `max_samples`."""
    found: list[tuple[int, float, float]] = []
    spent, samples = 0.0, 1
    with PathTracer(device, scene, size) as tracer:
        tracer.render(scene.camera, samples=1)
        tracer.reset()  # everything is compiled now
        while samples <= max_samples and (spent < seconds or not found):
            started = time.perf_counter()
            picture = tracer.render(scene.camera, samples=samples)["radiance"].astype(np.float64)
            spent += time.perf_counter() - started
            found.append((tracer.samples, spent, relative_mse(picture, truth)))
            samples *= 2
    return found


def seconds_to_reach(curve: list[tuple[int, float, float]], error: float) -> float:
    """The seconds after which the path tracer reaches this error, interpolated on its curve in logarithms.

    Beyond the end of the curve: error * time is constant, as for any Monte Carlo estimate.
    """
    times = np.log([point[1] for point in curve])
    errors = np.log([max(point[2], 1e-30) for point in curve])
    wanted = float(np.log(max(error, 1e-30)))
    if wanted < errors[-1]:
        return float(np.exp(times[-1] + errors[-1] - wanted))
    return float(np.exp(np.interp(-wanted, -np.minimum.accumulate(errors), times)))
