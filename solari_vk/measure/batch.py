"""`solari-vk bench batch`: views a second of `Batch`, beside the same views one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from solari_vk.batch import Batch
from solari_vk.bound.binder import SceneBinder
from solari_vk.gpu.device.device import Device
from solari_vk.measure.report import measuring
from solari_vk.measure.timing import seconds, warm
from solari_vk.output.animation import orbit
from solari_vk.reference import PathTracer
from solari_vk.scene.builtin import builtin
from solari_vk.scene.model import Camera
from solari_vk.tracer import RayTracer

SCENE, SAMPLES, ROUNDS = "cornell_box", 4, 5
NAMES = ("depth", "instance_id")
INTRO = (
    f"Views a second of `{SCENE}`, in turns and each the median of {ROUNDS} rounds, until results are numpy arrays. "
    "Labels are depth and instance ids; one by one they are those of `RayTracer`, whose rays Python makes. "
    f"Reference is the radiance of {SAMPLES} samples a pixel; one by one it is that of one `PathTracer`.",
)
HEAD = ("renderer and views", "views/s of a batch", "views/s one by one", "ratio")


def run(
    select: str | None, views: Sequence[int], size: tuple[int, int], markdown: Path | None, *, rays: str | None = None
) -> None:  # fmt: skip
    """Measure and report. views: of each batch. size: of a view."""
    with measuring(select, rays, markdown, "Batches", *INTRO) as (device, report):
        binder = SceneBinder(device, builtin(SCENE))
        rows = []
        for count in views:
            for name, together, alone in _works(device, binder, count, size):
                report.progress(f"{name}, {count} views")
                for work in (together, alone):
                    warm(device, work, 2, 0.2)
                times = np.array([[seconds(together), seconds(alone)] for _ in range(ROUNDS)])
                speeds = count / np.median(times, axis=0)
                ratio = np.median(times[:, 1] / times[:, 0])
                rows.append((f"{name}, {count}", f"{speeds[0]:,.1f}", f"{speeds[1]:,.1f}", f"{ratio:.2f}"))
        binder.destroy()
        report.table(f"Views of {size[0]}x{size[1]}", HEAD, rows)


def _works(device: Device, binder: SceneBinder, count: int, size: tuple[int, int]) -> Any:
    """(renderer, work of a batch, the same one by one), while each is needed."""
    cameras: list[Camera] = orbit(binder.scene.camera, binder.scene.bounds.center, count, 40.0)
    poses = np.stack([camera.transform for camera in cameras])
    fov = cameras[0].vertical_fov
    with Batch(device, binder, size, count) as batch, RayTracer(device, binder) as tracer:

        def labels() -> None:
            batch.render(poses, vertical_fov=fov)
            for name in NAMES:
                batch[name]

        yield "labels", labels, lambda: _trace(tracer, cameras, size)
    batch = Batch(device, binder, size, count, renderer="reference", seed=1)
    with batch, PathTracer(device, binder, size, seed=1) as single:

        def alone() -> None:
            for camera in cameras:
                single.reset()
                single.render(camera, samples=SAMPLES)["radiance"]

        yield "reference", lambda: batch.render(poses, vertical_fov=fov, samples=SAMPLES)["radiance"], alone


def _trace(tracer: RayTracer, cameras: Sequence[Camera], size: tuple[int, int]) -> None:
    pixels = np.stack(np.meshgrid(np.arange(size[0]), np.arange(size[1])), -1)
    for camera in cameras:
        tracer.trace(*camera.rays(pixels, size))
