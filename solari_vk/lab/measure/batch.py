"""`solari-vk bench batch`: views a second of `Batch`, beside the same views one after the other."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.batch.batch import Batch
from solari_vk.batch.many_frames import FrameResults
from solari_vk.batch.options import OPTIONS
from solari_vk.bound.binder import SceneBinder
from solari_vk.gpu.device.device import Device
from solari_vk.lab.measure.figures import Work, seconds, warm
from solari_vk.lab.measure.report import measuring
from solari_vk.output.animation import orbit
from solari_vk.renderers.path_tracer import PathTracer
from solari_vk.renderers.ray_tracer import RayTracer
from solari_vk.renderers.renderer import Renderer
from solari_vk.scene import shapes
from solari_vk.scene.builtin import builtin
from solari_vk.scene.material import Material
from solari_vk.scene.model import Camera, Scene

SAMPLES = 4
ROUNDS = 5
HOST_ROUNDS = 25
OBJECTS = 30
AT_ONCE = 8  # frames of render_many
# The frames of which the 95th percentile is taken: at most, at least, and the seconds that they may take.
STEADY_FRAMES = 200
FEWEST_FRAMES = 20
STEADY_SECONDS = 6.0
MOVED = ("short block", "tall block")  # in worlds
NAMES = ("depth", "instance_id")
INTRO = (
    f"Views a second of `cornell_box` with {OBJECTS} balls, in turns and each the median of {ROUNDS} rounds, until "
    "results are numpy arrays or, with `--tensors`, tensors on the device. "
    "Labels are depth and instance ids; one by one they are those of `RayTracer`, whose rays Python makes. "
    f"Reference is the radiance of {SAMPLES} samples a pixel; one by one it is that of one `PathTracer`. "
    "Realtime is the denoised radiance: of cameras that move a little, which one by one are one camera of one "
    "`Renderer`; and after a cut of all views. In worlds, each view has a world of its own, whose blocks move in each "
    "frame; nothing is one by one. Host is the time that `render` takes before the device works, for each view: the "
    f"median of {HOST_ROUNDS} frames, of which each waits for the one before. "
    f"In a row: how many times as many views a second there are with {AT_ONCE} frames, of which with "
    "`--tensors` nobody waits for one; "
    "at once: with as many by `render_many`. "
    "One view: pixels a second of the batch over those of one large view of about as many, from the first camera. "
    f"p95: the 95th percentile of a frame's time over the median, of {FEWEST_FRAMES} to {STEADY_FRAMES} frames in "
    f"{STEADY_SECONDS:g} s that follow the rounds.",
)
HEAD = ("renderer and views", "views/s of a batch", "views/s one by one", "ratio", "host us a view", "in a row",
        "at once", "one view", "p95")  # fmt: skip


class Row(NamedTuple):
    """Works: `begin` a frame of a batch, a frame `together` with taking results, AT_ONCE of them with `many`, the views
    of a frame `alone`, one by one, and about as many pixels as `one` view."""

    name: str
    begin: Work
    together: Work
    many: Work
    alone: Work | None = None
    one: Work | None = None


Rows = Iterator[Row]
"""Rows whose works can run until the next row is asked for."""


@dataclass(frozen=True)
class _Asked:
    """What a row is about. size: of a view. tensors: results stay on the device."""

    device: Device
    binder: SceneBinder
    views: int
    size: tuple[int, int]
    renderer: str
    tensors: bool

    @property
    def samples(self) -> int | None:
        """Samples a pixel, where the renderer takes a number of them."""
        return SAMPLES if self.renderer == "reference" else None

    @property
    def names(self) -> tuple[str, ...]:
        """The outputs that are read."""
        return NAMES if self.renderer == "labels" else ("radiance",)

    def batch(self, size: tuple[int, int], count: int, **options: Any) -> Batch:
        """A batch of this renderer."""
        kind: dict[str, Any] = {"outputs": NAMES} if self.renderer == "labels" else {"outputs": (), "seed": 1}
        return Batch(self.device, self.binder, size, count, renderer=self.renderer, **kind, **options)

    def read(self, results: Batch | FrameResults) -> None:
        """Wait for the results."""
        for name in self.names:
            _ = results.tensor(name) if self.tensors else results[name]


def run(
    select: str | None,
    views: Sequence[int],
    size: tuple[int, int],
    markdown: Path | None,
    *,
    rays: str | None = None,
    renderers: Sequence[str] = (),
    worlds: bool = False,
    tensors: bool = False,
) -> None:
    """Measure and report. views: of each batch. size: of a view. renderers: all, if there are none. worlds: batches
    with a world for each view too. tensors: results of batches stay on the device. Raises SolariError for an unknown
    renderer."""
    for name in renderers:
        if name not in OPTIONS:
            raise SolariError(f"bench batch: there is no renderer '{name}': give some of {', '.join(OPTIONS)}")
    with measuring(select, rays, markdown, "Batches", *INTRO) as (device, report):
        binder = SceneBinder(device, _scene())
        rows = []
        for count in views:
            for renderer in renderers or OPTIONS:
                asked = _Asked(device, binder, count, size, renderer, tensors)
                for row in _all_rows(asked, worlds):
                    report.progress(f"{row.name}, {count} views")
                    rows.append((f"{row.name}, {count}", *_measured(device, count, row)))
        binder.destroy()
        report.table(f"Views of {size[0]}x{size[1]}", HEAD, rows)


def _scene() -> Scene:
    scene = builtin("cornell_box")
    rng = np.random.default_rng(1)
    for _ in range(OBJECTS):
        material = Material(base_color=rng.random(3, np.float32), perceptual_roughness=float(rng.uniform(0.2, 1)))
        scene.add(shapes.sphere(0.08, 12), material, position=rng.uniform((0.2, 0.1, 0.2), (1.8, 1.5, 1.8)))
    return scene


def _measured(device: Device, count: int, row: Row) -> tuple[str, ...]:
    def until_done(work: Work, frames: int = 1) -> None:
        for _ in range(frames):
            work()
        device.wait_idle()

    functions = {"together": row.together, "many": row.many, "alone": row.alone, "one": row.one}
    works: dict[str, Work] = {name: partial(until_done, work) for name, work in functions.items() if work is not None}
    # The same frames without `render_many`.
    works["in a row"] = partial(until_done, row.together, AT_ONCE)
    # The first runs compile and allocate.
    for work in works.values():
        warm(device, work, 2, 0.2)
    # In turns, so that other work of the machine slows all of them.
    rounds = [[seconds(work) for work in works.values()] for _ in range(ROUNDS)]
    times = dict(zip(works, np.transpose(rounds), strict=True))
    together = times["together"]
    # The device is idle before each call, so that the call waits for nothing.
    host = []
    for _ in range(HOST_ROUNDS):
        device.wait_idle()
        host.append(seconds(row.begin))
    device.wait_idle()
    speed = f"{count / np.median(together):,.1f}"
    alone = ratio = "-"
    if "alone" in times:
        alone = f"{count / np.median(times['alone']):,.1f}"
        ratio = f"{np.median(times['alone'] / together):.2f}"
    many = (f"{np.median(AT_ONCE * together / times[name]):.2f}" for name in ("in a row", "many"))
    # Per pixel, since the grid of views may have fewer pixels than the batch.
    one = "-"
    if "one" in times:
        columns, rows = _grid(count)
        one = f"{np.median(count * times['one'] / (columns * rows * together)):.2f}"
    return (
        speed,
        alone,
        ratio,
        f"{1e6 * np.median(host) / count:.2f}",
        *many,
        one,
        f"{_spread(works['together']):.2f}",
    )


def _grid(count: int) -> tuple[int, int]:
    """Columns and rows of about so many views."""
    columns = math.isqrt(count)
    return columns, count // columns


def _spread(work: Work) -> float:
    """The 95th percentile over the median of the times of frames that follow each other."""
    times: list[float] = []
    while len(times) < FEWEST_FRAMES or (len(times) < STEADY_FRAMES and sum(times) < STEADY_SECONDS):
        times.append(seconds(work))
    return float(np.percentile(times, 95) / np.median(times))


def _cameras(binder: SceneBinder, count: int) -> tuple[list[Camera], NDArray[np.float64], float]:
    cameras: list[Camera] = orbit(binder.scene.camera, binder.scene.bounds.center, count, 40.0)
    return cameras, np.stack([camera.transform for camera in cameras]), cameras[0].vertical_fov


def _all_rows(asked: _Asked, worlds: bool) -> Rows:
    yield from _rows(asked)
    if worlds:
        yield from _rows_of_worlds(asked)


def _rows(asked: _Asked) -> Rows:
    """The rows of a batch that shows one scene."""
    device = asked.device
    binder = asked.binder
    count = asked.views
    size = asked.size
    cameras, poses, fov = _cameras(binder, count)
    columns, rows = _grid(count)
    with ExitStack() as stack:
        batch = stack.enter_context(asked.batch(size, count))
        # One large view, with about as many pixels as all views of the batch.
        single = stack.enter_context(asked.batch((size[0] * columns, size[1] * rows), 1))

        def render(cut: bool = False) -> None:
            batch.render(poses, vertical_fov=fov, samples=asked.samples, reset=cut)

        def read(cut: bool = False) -> None:
            render(cut)
            asked.read(batch)

        def read_one(cut: bool = False) -> None:
            single.render(poses[:1], vertical_fov=fov, samples=asked.samples, reset=cut)
            asked.read(single)

        def many(cut: bool = False) -> None:
            # Cameras that move a little, so that frames are no copies of each other.
            every = np.tile(poses, (AT_ONCE, 1, 1, 1))
            every[:, :, :3, 3] += 1e-3 * np.sin(np.arange(AT_ONCE))[:, None, None]
            cuts = np.full((AT_ONCE, count), cut)
            frames = batch.render_many(
                every, frames=AT_ONCE, outputs=asked.names, vertical_fov=fov, samples=asked.samples, reset=cuts
            )
            asked.read(frames)

        if asked.renderer == "labels":
            tracer = stack.enter_context(RayTracer(device, binder))
            yield Row("labels", render, read, many, lambda: _trace(tracer, cameras, size), read_one)
        elif asked.renderer == "reference":
            path_tracer = stack.enter_context(PathTracer(device, binder, size, seed=1))

            def alone() -> None:
                for camera in cameras:
                    path_tracer.reset()
                    path_tracer.render(camera, samples=SAMPLES)["radiance"]

            yield Row("reference", render, read, many, alone, read_one)
        else:
            renderer = stack.enter_context(Renderer(device, binder, size, seed=1))
            frame = itertools.count()

            def moving(work: Work) -> None:
                poses[:, :3, 3] += 1e-3 * np.sin(next(frame))
                work()

            def follow() -> None:
                for _ in cameras:
                    renderer.render(cameras[0])["radiance"]

            def cut_to_each() -> None:
                for camera in cameras:
                    renderer.reset()
                    renderer.render(camera)["radiance"]

            yield Row("realtime, moving", render, lambda: moving(read), many, follow, lambda: moving(read_one))
            yield Row(
                "realtime, cut",
                partial(render, True),
                partial(read, True),
                partial(many, True),
                cut_to_each,
                partial(read_one, True),
            )


def _rows_of_worlds(asked: _Asked) -> Rows:
    """The row of a batch with a world for each view, whose blocks move in each frame."""
    count = asked.views
    _, poses, fov = _cameras(asked.binder, count)
    with asked.batch(asked.size, count, worlds=count) as batch:
        places = {name: batch.transforms[name] for name in MOVED}
        rng = np.random.default_rng(1)

        def render() -> None:
            for name, place in places.items():
                # Along x and z: blocks stay on the floor.
                place[:, ::2, 3] += rng.uniform(-1e-3, 1e-3, (count, 2))
                batch.transforms[name] = place
            batch.render(poses, vertical_fov=fov, samples=asked.samples)

        def read() -> None:
            render()
            asked.read(batch)

        def many() -> None:
            moves = {name: np.tile(place, (AT_ONCE, 1, 1, 1)) for name, place in places.items()}
            for move in moves.values():
                move[:, :, ::2, 3] += rng.uniform(-1e-3, 1e-3, (AT_ONCE, count, 2))
            frames = batch.render_many(
                poses, frames=AT_ONCE, outputs=asked.names, transforms=moves, vertical_fov=fov, samples=asked.samples
            )
            asked.read(frames)

        yield Row(f"{asked.renderer}, worlds", render, read, many)


def _trace(tracer: RayTracer, cameras: Sequence[Camera], size: tuple[int, int]) -> None:
    pixels = np.stack(np.meshgrid(np.arange(size[0]), np.arange(size[1])), -1)
    for camera in cameras:
        tracer.trace(*camera.rays(pixels, size))
