"""`solari-vk bench first-frames`: errors of first frames after a cut, alone and in batches."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.batch.batch import Batch
from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.projection import JITTERS
from solari_vk.gpu.device.device import Device
from solari_vk.lab.measure.figures import seconds
from solari_vk.lab.measure.report import measuring
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
            rows.append(_cells(name, _errors(device, name, views, size, samples)))
        report.table(f"{views} views of {size[0]}x{size[1]}", HEAD, rows)


class _Errors(NamedTuple):
    """The relMSE of whole pictures, and of their light: without the pixels at edges."""

    alone: float
    batch: float
    light_alone: float
    light_batch: float
    light_more_paths: float
    """In a batch with MORE_PATHS, whose time is `time_ratio` of that without them."""
    time_ratio: float
    later: float
    """Of frame LATER alone."""
    path_tracer: float
    """With four samples."""


def _cells(name: str, errors: _Errors) -> list[str]:
    """The cells below HEAD."""
    return [
        name,
        f"{errors.alone:.4f}",
        f"{errors.batch:.4f}",
        f"{errors.batch / errors.alone:.2f}",
        f"{errors.light_alone:.4f}",
        f"{errors.light_batch:.4f}",
        f"{errors.light_batch / errors.light_alone:.2f}",
        f"{errors.light_more_paths:.4f}",
        f"{errors.light_more_paths / errors.light_alone:.2f}",
        f"{errors.time_ratio:.2f}",
        f"{errors.later:.4f}",
        f"{errors.path_tracer:.4f}",
    ]


def _errors(device: Device, name: str, views: int, size: tuple[int, int], samples: int) -> _Errors:
    scene = builtin(name)
    rng = np.random.default_rng(1)
    places = [around(scene.camera, rng) for _ in range(views)]
    binder = SceneBinder(device, scene)
    first, second, few = _path_traced(device, binder, size, places, samples)
    with Batch(device, binder, size, views, outputs=("instance_id", "geometric_normal")) as batch:
        batch.render(places)
        inner = ~_edges(batch["instance_id"], batch["geometric_normal"])
    every = np.ones_like(inner)

    def error(pictures: NDArray[Any], where: NDArray[np.bool_]) -> float:
        each = zip(pictures, first, second, where, strict=True)
        return float(np.mean([true_relative_mse(picture[mask], a[mask], b[mask]) for picture, a, b, mask in each]))

    earlier = [[around(scene.camera, rng) for _ in range(views)] for _ in range(EARLIER)]
    (alone, shared, time), (_, more, longer_time) = _cuts(device, binder, size, places, earlier)
    with Renderer(device, binder, size, seed=4) as renderer:
        later = np.stack([_later(renderer, camera) for camera in places])
    binder.destroy()
    return _Errors(
        error(alone, every),
        error(shared, every),
        error(alone, inner),
        error(shared, inner),
        error(more, inner),
        longer_time / time,
        error(later, every),
        error(few, every),
    )


def _path_traced(
    device: Device, binder: SceneBinder, size: tuple[int, int], places: Sequence[Camera], samples: int
) -> list[NDArray[Any]]:
    """The path tracer's views: two with independent noise, and one with four samples a pixel."""
    found = []
    with PathTracer(device, binder, size) as tracer:
        for seed, count in ((1, samples), (2, samples), (3, 4)):
            tracer.seed = seed
            found.append(np.stack([tracer.render(camera, samples=count)["radiance"] for camera in places]))
    return found


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
        # Frames of as many cuts later have samples at the same positions again.
        last = [show(batch, places) for batch in batches]
        return list(zip(first, last, np.median(times, axis=0), strict=True))


def _later(renderer: Renderer, camera: Camera) -> NDArray[np.float32]:
    renderer.reset()
    for _ in range(LATER):
        frame = renderer.render(camera)
    return frame["radiance"]


def _edges(ids: NDArray[Any], normals: NDArray[Any]) -> NDArray[np.bool_]:
    """The pixels of views (N, height, width) beside which another surface is seen."""
    # Another instance beside a pixel, or a normal that is more than 26 degrees away.
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
