"""`solari-vk bench ways`: how fast rays, frames and the path tracer are by each method of tracing rays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.bound.binder import SceneBinder
from solari_vk.gpu.device.device import Device
from solari_vk.lab.measure.bare_rays import BOUNCES, BarePaths, plain_tracer
from solari_vk.lab.measure.denoised import SEED
from solari_vk.lab.measure.figures import Work, device_seconds, warm
from solari_vk.lab.measure.report import Report, milliseconds
from solari_vk.lab.measure.scenes import from_file
from solari_vk.renderers.path_tracer import PathTracer
from solari_vk.renderers.ray_tracer import RayTracer
from solari_vk.renderers.renderer import Renderer
from solari_vk.renderers.scene_frame import SceneFrame
from solari_vk.scene.builtin import builtin
from solari_vk.scene.calibrated import pixel_rays
from solari_vk.scene.model import Camera, Scene

SCENES = ("cornell_box", "many_lights", "rooms", "sphere_grid", "polished_floor", "mirror_hall")
RAYS_WARM_UP = 0.5
"""Seconds; GPUs clock down when they are idle."""
RAYS_RUNS = 12
FRAME_WARM_UP = 1.2
FRAMES = 40
CUTS = 4
AFTER_CUT = 20
"""Frames between two cuts."""
FIRST_SAMPLES = 8
SAMPLES = 32
TOLERANCE = 1e-3
"""Of distances to hits, relative, and the share of rays that may have other hits."""
INTRO = (
    "Camera rays, diffuse rays and paths: millions of closest-hit rays a second without shading, medians of "
    f"{RAYS_RUNS} runs. Diffuse: one ray from each hit of a camera ray, distributed by the cosine. All methods trace "
    f"the same rays. Paths: up to {BOUNCES + 1} rays for each pixel, traced in one kernel.",
    f"Frame: milliseconds of a denoised frame, the median of {FRAMES}. First frame: the frame after a reset, the "
    f"median of {CUTS}. Times on the device, all passes together. Sample: wall-clock milliseconds of the path tracer "
    f"for one sample of each pixel, the mean of {SAMPLES}.",
    "In brackets: the speed over that of the scene's first method; more than 1 is faster. Other hits: the share of "
    f"camera and diffuse rays whose distance differs from that of the first method by more than {TOLERANCE:g} of it.",
)
HEAD = ("scene, method", "camera rays", "diffuse rays", "paths", "frame", "first frame", "sample", "other hits")
RATES = 3
"""The first figures are rates; the others are times."""
Rays = tuple[NDArray[np.float32], NDArray[np.float32]]


class Measured(NamedTuple):
    """A scene by one method."""

    figures: list[float]
    """In the order of HEAD: millions of rays a second, then milliseconds."""
    distances: NDArray[np.float32]
    """To the hits of camera rays and diffuse rays, infinite for a miss."""


@dataclass
class Subject:
    """A scene, its camera, and what was measured with each method."""

    scene: Scene
    camera: Camera
    size: tuple[int, int]
    rays: tuple[Rays, ...] = ()
    """Camera rays and diffuse rays, once they are made."""
    measured: dict[str, Measured] = field(default_factory=dict)


def run(
    select: str | None,
    *,
    rays: str | None = None,
    markdown: Path | None = None,
    files: Sequence[Path] = (),
    scene: Sequence[str] = (),
    size: tuple[int, int] = (1920, 1080),
) -> None:
    """Measure and print a table. rays: only this method, by default all that the device has. files, and scene, names of
    built-in scenes: what is measured, by default SCENES. size: (width, height) of pictures in pixels, and the number of
    camera rays. Raises SolariError for unknown scenes, for one whose camera sees nothing, and without a folder for the
    page."""
    scenes = [*map(builtin, scene or (() if files else SCENES)), *map(from_file, files)]
    subjects = [Subject(one, one.camera_for(size[0] / size[1]), size) for one in scenes]
    with Device(select, rays=rays) as device:
        ways = [device.rays] if rays else [way for way, missing in device.missing_rays.items() if not missing]
        facts = f"by {', '.join(ways)}"
        report = Report(device, markdown, "Rays, frames and samples by method of tracing", INTRO, rays=facts)
        same = device.properties.uuid
    for way in ways:
        with Device(same, rays=way) as device:
            for subject in subjects:
                report.progress(f"{subject.scene.name}, {way}")
                subject.measured[way] = measure(device, subject)
    rows = [row for subject in subjects for row in table_rows(subject)]
    report.table(f"{size[0]}x{size[1]}", HEAD, rows, *(note for subject in subjects for note in notes(subject)))
    if markdown is not None:
        print(f"wrote {markdown}")


def measure(device: Device, subject: Subject) -> Measured:
    """A scene by the method of a device, which also makes the subject's rays if there are none yet."""
    camera, size = subject.camera, subject.size
    figures = []
    distances = []
    with RayTracer(device, subject.scene) as tracer:
        subject.rays = subject.rays or make_rays(tracer, camera, size)
        binder = tracer.binder
        for origins, directions in subject.rays:
            placed = _single(origins - binder.origin)
            with plain_tracer(device, binder, placed, directions) as plain:
                figures.append(len(origins) / _run_time(plain) / 1e3)
                distances.append(plain["plain_distances"])
        with BarePaths(device, binder, camera, size) as paths:
            _, count = paths.run(0)
            figures.append(count / _run_time(paths.frame) / 1e3)
        figures += [*_frame_times(device, binder, camera, size), _sample_time(device, binder, camera, size)]
    return Measured(figures, np.concatenate(distances))


def make_rays(tracer: RayTracer, camera: Camera, size: tuple[int, int]) -> tuple[Rays, Rays]:
    """Camera rays, one through the middle of each pixel, and a diffuse ray from each of their hits."""
    pixels = np.indices((size[1], size[0]), np.float64)[::-1].reshape(2, -1).T + 0.5
    origins, directions, starts = pixel_rays(camera, pixels, size)
    # Some lenses see nothing at the edges of the picture.
    seen = np.isfinite(directions).all(axis=1)
    first = _single(origins + starts[:, None] * directions)[seen], _single(directions)[seen]
    hits = tracer.trace(*first)
    found = np.isfinite(hits["t"])
    if not found.any():
        raise SolariError(f"bench ways: the camera of {tracer.binder.scene.name} sees no surface")
    hits, along = hits[found], first[1][found]
    # Before the surface, so that rays don't hit it again.
    points = hits["position"] - 1e-4 * hits["t"][:, None] * along
    facing = np.where((hits["normal"] * along).sum(axis=1, keepdims=True) > 0, -hits["normal"], hits["normal"])
    # A point of the unit sphere about the normal's end is in a direction that is distributed by the cosine.
    scattered = np.random.default_rng(SEED).normal(size=facing.shape)
    scattered = facing + scattered / np.linalg.norm(scattered, axis=1, keepdims=True)
    scattered /= np.linalg.norm(scattered, axis=1, keepdims=True)
    return first, (_single(points), _single(scattered))


def _single(values: NDArray[Any]) -> NDArray[np.float32]:
    return values.astype(np.float32)


def _milliseconds(device: Device, work: Work, timed: SceneFrame | Renderer) -> float:
    """The time of some work that submits a frame, on the device where it has timestamps."""
    whole = device_seconds(device, work)
    return sum(timed.timings.values()) or 1e3 * whole


def _run_time(frame: SceneFrame) -> float:
    """The median of the milliseconds of a frame's runs."""
    warm(frame.device, frame.submit, 1, RAYS_WARM_UP)
    return float(np.median([_milliseconds(frame.device, frame.submit, frame) for _ in range(RAYS_RUNS)]))


def _frame_times(device: Device, binder: SceneBinder, camera: Camera, size: tuple[int, int]) -> tuple[float, float]:
    """Milliseconds of a denoised frame, and of one after a reset."""
    first = []
    with Renderer(device, binder, size, seed=SEED) as renderer:

        def render() -> None:
            renderer.render(camera)

        warm(device, render, 1, FRAME_WARM_UP)
        frames = [_milliseconds(device, render, renderer) for _ in range(FRAMES)]
        for _ in range(CUTS):
            warm(device, render, AFTER_CUT, 0.0)
            renderer.reset()
            first.append(_milliseconds(device, render, renderer))
    return float(np.median(frames)), float(np.median(first))


def _sample_time(device: Device, binder: SceneBinder, camera: Camera, size: tuple[int, int]) -> float:
    """Milliseconds of the path tracer for a sample of each pixel."""
    with PathTracer(device, binder, size, seed=SEED) as path_tracer:

        def render(samples: int) -> None:
            path_tracer.reset()
            path_tracer.render(camera, samples)

        warm(device, lambda: render(FIRST_SAMPLES), 1, RAYS_WARM_UP)
        return 1e3 * device_seconds(device, lambda: render(SAMPLES)) / SAMPLES


def other_hits(subject: Subject, way: str) -> float:
    """The share of a subject's rays that have other hits by this method than by the first one."""
    expected = next(iter(subject.measured.values())).distances
    # Infinite distances are equal to each other only.
    return float(np.mean(~np.isclose(subject.measured[way].distances, expected, rtol=TOLERANCE, atol=0)))


def table_rows(subject: Subject) -> list[list[str]]:
    """A row of the table for each method."""
    rows = []
    first = next(iter(subject.measured.values())).figures
    for way, measured in subject.measured.items():
        cells = []
        for column, (figure, base) in enumerate(zip(measured.figures, first, strict=True)):
            speed = figure / base if column < RATES else base / figure
            cells.append(f"{milliseconds(figure)} ({speed:.2f})")
        rows.append([f"{subject.scene.name}, {way}", *cells, f"{other_hits(subject, way):.3%}"])
    return rows


def notes(subject: Subject) -> list[str]:
    """A warning for each method that finds too many other hits to be compared."""
    shares = {way: other_hits(subject, way) for way in subject.measured}
    return [
        f"{subject.scene.name}, {way}: {share:.2%} of the rays have other hits than by {next(iter(shares))}, so its "
        "figures can't be compared."
        for way, share in shares.items()
        if share > TOLERANCE
    ]
