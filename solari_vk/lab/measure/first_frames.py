"""`solari-vk bench first-frames`: errors of first frames after a cut, alone and in batches."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.batch.batch import Batch
from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.projection import JITTERS
from solari_vk.gpu.device.device import Device
from solari_vk.lab.measure.report import measuring
from solari_vk.lab.measure.timing import seconds
from solari_vk.output.compare import true_relative_mse
from solari_vk.renderers.path_tracer import PathTracer
from solari_vk.renderers.renderer import Renderer
from solari_vk.scene.builtin import builtin
from solari_vk.scene.model import Camera
from solari_vk.settings import Settings

SCENES = ("cornell_box", "mirror_hall", "shiny_floor", "thin_wall")
INTRO = (
    "relMSE of denoised views after a cut, against the path tracer: the noise of its two pictures of each view cancels "
    "out. Alone: the world cache is empty, as after a reset of a `Renderer`. In a batch: all views are cut in each "
    "frame and show the scene from new places, but share the world cache of earlier frames. The same places, with"
    " samples at the same positions in pixels, are measured in both. Light: without the pixels at edges of surfaces, "
    "of which one frame has too few samples, whatever their light. With 4 paths: that light in a batch that takes 4 "
    "paths a pixel after a cut (`paths_short_history_samples=4`), and its time over that with 2, the default.",
)
HEAD = ("scene", "frame 1 alone", "in a batch", "ratio", "light alone", "in a batch", "ratio", "with 4 paths", "ratio",
        "x time", "frame 8 alone", "path tracer, 4 samples")  # fmt: skip
MORE_PATHS = Settings(paths_short_history_samples=4)
EARLIER = len(JITTERS) - 1  # frames of other places, after which samples are at the same positions again
LATER = 8


def run(
    select: str | None,
    views: int,
    size: tuple[int, int],
    samples: int,
    scenes: Sequence[str],
    markdown: Path | None,
    *,
    rays: str | None = None,
) -> None:
    """Measure and report. views: of the batch. size: of a view. samples: of the path tracer's pictures."""
    with measuring(select, rays, markdown, "First frames", *INTRO) as (device, report):
        rows = []
        for name in scenes or SCENES:
            report.progress(name)
            alone, shared, light_alone, light_shared, light_more, slower, later, few = _errors(
                device, name, views, size, samples
            )
            rows.append(
                (
                    name,
                    f"{alone:.4f}",
                    f"{shared:.4f}",
                    f"{shared / alone:.2f}",
                    f"{light_alone:.4f}",
                    f"{light_shared:.4f}",
                    f"{light_shared / light_alone:.2f}",
                    f"{light_more:.4f}",
                    f"{light_more / light_alone:.2f}",
                    f"{slower:.2f}",
                    f"{later:.4f}",
                    f"{few:.4f}",
                )
            )
        report.table(f"{views} views of {size[0]}x{size[1]}", HEAD, rows)


def _errors(device: Device, name: str, views: int, size: tuple[int, int], samples: int) -> tuple[float, ...]:
    """Whole pictures, alone and in a batch; their light, also with MORE_PATHS, and how much slower that is; frame
    LATER, and the path tracer."""
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
    with Batch(device, binder, size, views, outputs=("instance_id", "geometric_normal")) as batch:
        batch.render(places)
        inner = ~_edges(batch["instance_id"], batch["geometric_normal"])

    def error(picture: NDArray[Any], where: NDArray[np.bool_]) -> float:
        each = zip(picture, *truths, where, strict=True)
        return float(np.mean([true_relative_mse(*(found[mask] for found in of)) for *of, mask in each]))

    earlier = [[around(scene.camera, rng) for _ in range(views)] for _ in range(EARLIER)]
    (alone, shared, time), (_, more, longer_time) = _cuts(device, binder, size, places, earlier)
    with Renderer(device, binder, size, seed=4) as renderer:
        later = np.stack([_later(renderer, camera) for camera in places])
    binder.destroy()
    every = np.ones_like(inner)
    errors = [error(picture, where) for where in (every, inner) for picture in (alone, shared)]
    return (*errors, error(more, inner), longer_time / time, error(later, every), error(few, every))


def _cuts(
    device: Device,
    binder: SceneBinder,
    size: tuple[int, int],
    places: Sequence[Camera],
    earlier: Sequence[Sequence[Camera]],
) -> list[tuple[NDArray[np.float32], NDArray[np.float32], float]]:
    """For the default settings and MORE_PATHS: what a batch shows of places after a cut, at first and after cuts to
    earlier places, and the time of one of these, in turns."""

    def show(batch: Batch, cameras: Sequence[Camera]) -> NDArray[np.float32]:
        return np.asarray(batch.render(cameras, reset=True)["radiance"])

    with ExitStack() as stack:
        options: dict[str, Any] = {"renderer": "realtime", "outputs": (), "seed": 4}
        batches = [
            stack.enter_context(Batch(device, binder, size, len(places), settings=settings, **options))
            for settings in (Settings(), MORE_PATHS)
        ]
        first = [show(batch, places) for batch in batches]
        times = [[seconds(partial(show, batch, cameras)) for batch in batches] for cameras in earlier]
        return list(zip(first, [show(batch, places) for batch in batches], np.median(times, axis=0), strict=True))


def _later(renderer: Renderer, camera: Camera) -> NDArray[np.float32]:
    renderer.reset()
    for _ in range(LATER):
        frame = renderer.render(camera)
    return frame["radiance"]


def _edges(ids: NDArray[Any], normals: NDArray[Any]) -> NDArray[np.bool_]:
    """The pixels of views (N, height, width) beside which another surface is seen."""
    found = np.zeros(ids.shape, bool)
    for axis in (1, 2):
        for step in (-1, 1):
            other = np.roll(ids, step, axis) != ids
            found |= other | ((np.roll(normals, step, axis) * normals).sum(-1) < 0.9)
    return found


def around(camera: Camera, rng: np.random.Generator) -> Camera:
    """A camera near another one, which looks at about the same."""
    reach = rng.uniform(-0.25, 0.25, 3)
    transform = camera.transform.copy()
    transform[:3, 3] += camera.transform[:3, :3] @ reach
    turn = Camera.look_at((0, 0, 0), (*rng.uniform(-0.2, 0.2, 2), -1)).transform
    return Camera(transform=transform @ turn, vertical_fov=camera.vertical_fov, ev100=camera.ev100, near=camera.near)
