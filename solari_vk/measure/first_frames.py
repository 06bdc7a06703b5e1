"""`solari-vk bench first-frames`: errors of first frames after a cut, alone and in batches."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from solari_vk.batch import Batch
from solari_vk.bound.binder import SceneBinder
from solari_vk.gpu.device.device import Device
from solari_vk.measure.report import measuring
from solari_vk.measure.statistics import true_relative_mse
from solari_vk.reference import PathTracer
from solari_vk.scene.builtin import builtin
from solari_vk.scene.model import Camera

SCENES = ("cornell_box", "mirror_hall", "shiny_floor", "thin_wall")
INTRO = (
    "relMSE of denoised views after a cut, against the path tracer: the noise of its two pictures of each view cancels "
    "out. Alone: the world cache is empty, as after a reset of a `Renderer`. In a batch: all views are cut in each "
    "frame and show the scene from new places, but share the world cache of earlier frames. The same places are "
    "measured in both.",
)
HEAD = ("scene", "frame 1, alone", "frame 1, in a batch", "ratio", "frame 8, alone", "path tracer, 4 samples")
EARLIER = 16  # frames of other views, before those that are measured
LATER = 8


def run(
    select: str | None, views: int, size: tuple[int, int], samples: int, scenes: Sequence[str], markdown: Path | None,
    *, rays: str | None = None,
) -> None:  # fmt: skip
    """Measure and report. views: of the batch. size: of a view. samples: of the path tracer's pictures."""
    with measuring(select, rays, markdown, "First frames", *INTRO) as (device, report):
        rows = []
        for name in scenes or SCENES:
            report.progress(name)
            errors = _errors(device, name, views, size, samples)
            ratio = errors[1] / errors[0]
            rows.append((name, *(f"{error:.4f}" for error in errors[:2]), f"{ratio:.2f}",
                         *(f"{error:.4f}" for error in errors[2:])))  # fmt: skip
        report.table(f"{views} views of {size[0]}x{size[1]}", HEAD, rows)


def _errors(device: Device, name: str, views: int, size: tuple[int, int], samples: int) -> tuple[float, ...]:
    scene = builtin(name)
    rng = np.random.default_rng(1)
    places = [around(scene.camera, rng) for _ in range(views)]
    binder = SceneBinder(device, scene)
    truths = []
    with PathTracer(device, binder, size) as tracer:
        for seed in (1, 2):
            tracer.seed = seed
            truths.append(np.stack([tracer.render(camera, samples=samples)["radiance"] for camera in places]))
        tracer.seed = 3
        few = np.stack([tracer.render(camera, samples=4)["radiance"] for camera in places])
    with Batch(device, binder, size, views, renderer="realtime", outputs=(), seed=4) as batch:
        alone = _alone(batch, places)
        for _ in range(EARLIER):
            batch.render([around(scene.camera, rng) for _ in range(views)], reset=True)
        shared = batch.render(places, reset=True)["radiance"]
    binder.destroy()
    pictures = (alone[0], shared, alone[1], few)
    return tuple(
        float(np.mean([true_relative_mse(*of) for of in zip(found, *truths, strict=True)])) for found in pictures
    )


def _alone(batch: Batch, places: Sequence[Camera]) -> list[NDArray[np.float32]]:
    """Frames 1 and LATER of each view without what the other views see."""
    found = []
    for camera in places:
        batch.render([camera] * batch.views, reset=True, reset_cache=True)
        first = batch["radiance"][0]
        for _ in range(LATER - 1):
            batch.render([camera] * batch.views)
        found.append((first, batch["radiance"][0]))
    return [np.stack(frames) for frames in zip(*found, strict=True)]


def around(camera: Camera, rng: np.random.Generator) -> Camera:
    """A camera near another one, which looks at about the same."""
    reach = rng.uniform(-0.25, 0.25, 3)
    transform = camera.transform.copy()
    transform[:3, 3] += camera.transform[:3, :3] @ reach
    turn = Camera.look_at((0, 0, 0), (*rng.uniform(-0.2, 0.2, 2), -1)).transform
    return Camera(transform=transform @ turn, vertical_fov=camera.vertical_fov, ev100=camera.ev100, near=camera.near)
