"""`solari-vk bench batch`: views a second of `Batch`, beside the same views one after the other."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.batch import Batch
from solari_vk.batch_options import OPTIONS
from solari_vk.bound.binder import SceneBinder
from solari_vk.errors import SolariError
from solari_vk.gpu.device.device import Device
from solari_vk.measure.report import measuring
from solari_vk.measure.timing import seconds, warm
from solari_vk.output.animation import orbit
from solari_vk.reference import PathTracer
from solari_vk.renderer import Renderer
from solari_vk.scene import shapes
from solari_vk.scene.builtin import builtin
from solari_vk.scene.material import Material
from solari_vk.scene.model import Camera, Scene
from solari_vk.tracer import RayTracer

SAMPLES, ROUNDS, OBJECTS = 4, 5, 30
MOVED = ("short block", "tall block")  # in worlds
NAMES = ("depth", "instance_id")
INTRO = (
    f"Views a second of `cornell_box` with {OBJECTS} balls, in turns and each the median of {ROUNDS} rounds, until "
    "results are numpy arrays or, with `--tensors`, tensors on the device. "
    "Labels are depth and instance ids; one by one they are those of `RayTracer`, whose rays Python makes. "
    f"Reference is the radiance of {SAMPLES} samples a pixel; one by one it is that of one `PathTracer`. "
    "Realtime is the denoised radiance: of cameras that move a little, which one by one are one camera of one "
    "`Renderer`; and after a cut of all views. In worlds, each view has a world of its own, whose blocks move in each "
    "frame; nothing is one by one. Host is the time that `render` takes before the device works, for each view.",
)
HEAD = ("renderer and views", "views/s of a batch", "views/s one by one", "ratio", "host us a view")

Work = Callable[[], object]
Works = Iterator[tuple[str, Work, Work, Work | None]]
"""Rows, while they are needed: a name, the work of a batch without and with reading, the same one by one."""


def run(
    select: str | None, views: Sequence[int], size: tuple[int, int], markdown: Path | None, *, rays: str | None = None,
    renderers: Sequence[str] = (), worlds: bool = False, tensors: bool = False,
) -> None:  # fmt: skip
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
                works = [_works(device, binder, count, size, renderer, tensors)]
                works += [_works_in_worlds(device, binder, count, size, renderer, tensors)] * worlds
                for name, begin, together, alone in (row for found in works for row in found):
                    report.progress(f"{name}, {count} views")
                    rows.append((f"{name}, {count}", *_measured(device, count, begin, together, alone)))
        binder.destroy()
        report.table(f"Views of {size[0]}x{size[1]}", HEAD, rows)


def _scene() -> Scene:
    scene, rng = builtin("cornell_box"), np.random.default_rng(1)
    for _ in range(OBJECTS):
        material = Material(base_color=rng.random(3, np.float32), perceptual_roughness=float(rng.uniform(0.2, 1)))
        scene.add(shapes.sphere(0.08, 12), material, position=rng.uniform((0.2, 0.1, 0.2), (1.8, 1.5, 1.8)))
    return scene


def _take(device: Device, batch: Batch, names: Sequence[str], tensors: bool) -> None:
    for name in names:
        _ = batch.tensor(name) if tensors else batch[name]
    if tensors:
        device.wait_idle()


def _measured(device: Device, count: int, begin: Work, together: Work, alone: Work | None) -> tuple[str, ...]:
    works = [together] if alone is None else [together, alone]
    for work in works:
        warm(device, work, 2, 0.2)
    times = np.array([[seconds(work) for work in works] for _ in range(ROUNDS)])
    host = []
    for _ in range(ROUNDS):
        device.wait_idle()
        host.append(seconds(begin))
    device.wait_idle()
    speeds = [f"{count / time:,.1f}" for time in np.median(times, axis=0)]
    if alone is not None:
        speeds.append(f"{np.median(times[:, 1] / times[:, 0]):.2f}")
    return (*speeds, *["-"] * (3 - len(speeds)), f"{1e6 * min(host) / count:.2f}")


def _cameras(binder: SceneBinder, count: int) -> tuple[list[Camera], NDArray[np.float64], float]:
    cameras: list[Camera] = orbit(binder.scene.camera, binder.scene.bounds.center, count, 40.0)
    return cameras, np.stack([camera.transform for camera in cameras]), cameras[0].vertical_fov


def _works(
    device: Device, binder: SceneBinder, count: int, size: tuple[int, int], renderer: str, tensors: bool
) -> Works:
    cameras, poses, fov = _cameras(binder, count)
    options: dict[str, Any] = {"outputs": NAMES} if renderer == "labels" else {"outputs": (), "seed": 1}
    with Batch(device, binder, size, count, renderer=renderer, **options) as batch:
        samples = SAMPLES if renderer == "reference" else None

        def render(cut: bool = False) -> None:
            batch.render(poses, vertical_fov=fov, samples=samples, reset=cut)

        def read(cut: bool = False) -> None:
            render(cut)
            _take(device, batch, NAMES if renderer == "labels" else ("radiance",), tensors)

        if renderer == "labels":
            with RayTracer(device, binder) as tracer:
                yield "labels", render, read, lambda: _trace(tracer, cameras, size)
        elif renderer == "reference":
            with PathTracer(device, binder, size, seed=1) as single:

                def alone() -> None:
                    for camera in cameras:
                        single.reset()
                        single.render(camera, samples=SAMPLES)["radiance"]

                yield "reference", render, read, alone
        else:
            with Renderer(device, binder, size, seed=1) as frames:

                def move() -> None:
                    poses[:, :3, 3] += 1e-3 * np.sin(len(moves))
                    moves.append(None)
                    read()

                def follow(cut: bool) -> None:
                    for camera in cameras:
                        if cut:
                            frames.reset()
                        frames.render(camera if cut else cameras[0])["radiance"]

                moves: list[None] = []
                yield "realtime, moving", render, move, lambda: follow(False)
                yield "realtime, cut", lambda: render(True), lambda: read(True), lambda: follow(True)


def _works_in_worlds(
    device: Device, binder: SceneBinder, count: int, size: tuple[int, int], renderer: str, tensors: bool
) -> Works:
    _, poses, fov = _cameras(binder, count)
    options: dict[str, Any] = {"outputs": NAMES} if renderer == "labels" else {"outputs": (), "seed": 1}
    with Batch(device, binder, size, count, renderer=renderer, worlds=count, **options) as batch:
        samples = SAMPLES if renderer == "reference" else None
        places = {name: batch.transforms[name] for name in MOVED}
        rng = np.random.default_rng(1)

        def render() -> None:
            for name, place in places.items():
                place[:, ::2, 3] += rng.uniform(-1e-3, 1e-3, (count, 2))
                batch.transforms[name] = place
            batch.render(poses, vertical_fov=fov, samples=samples)

        def read() -> None:
            render()
            _take(device, batch, NAMES if renderer == "labels" else ("radiance",), tensors)

        yield f"{renderer}, worlds", render, read, None


def _trace(tracer: RayTracer, cameras: Sequence[Camera], size: tuple[int, int]) -> None:
    pixels = np.stack(np.meshgrid(np.arange(size[0]), np.arange(size[1])), -1)
    for camera in cameras:
        tracer.trace(*camera.rays(pixels, size))
