"""`solari-vk bench portals`: what a portal in the window of a room saves, by the path tracer and in realtime frames."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from solari_vk.gpu.device.device import Device
from solari_vk.lab.measure.compared_settings import milliseconds
from solari_vk.lab.measure.denoised import SEED, Case, Look, Picture, measure, path_traced
from solari_vk.lab.measure.figures import interval
from solari_vk.lab.measure.report import measuring
from solari_vk.output.compare import true_relative_mse
from solari_vk.renderers.path_tracer import PathTracer
from solari_vk.scene import shapes
from solari_vk.scene.builtin import matte, place, rgb
from solari_vk.scene.lights.environment import Environment, EnvironmentLight
from solari_vk.scene.lights.portal import Portal
from solari_vk.scene.lights.sky import Sky
from solari_vk.scene.model import Camera, Scene
from solari_vk.settings import Settings

Errors = NDArray[np.float64]
INTRO = (
    "relMSE against the path tracer with many samples (its noise cancels out) without a portal in the window (before) "
    "and with it (after); ± is half of the 95 % interval of the ratio over runs with different seeds. The path tracer "
    "is timed by the clock, realtime frames by their passes, medians in turns. Error x time: below 1 the portal pays."
)
HEAD = ("sky", "picture", "before", "after", "ratio", "ms, before", "after", "error x time")
FRAMES = (1, 8, 32)


def run(
    select: str | None,
    files: Sequence[Path],
    *,
    rays: str | None = None,
    markdown: Path | None = None,
    size: tuple[int, int] = (128, 96),
    samples: int = 64,
    converged: int = 16384,
    seeds: int = 4,
    quick: bool = False,
) -> None:
    """Measure and print a table.

    files: environment maps beside the built-in skies. size: of the pictures, (width, height). samples: of the path
    tracer's pictures whose error is measured. converged: of their references. quick: tiny pictures of one sky.
    """
    skies: list[tuple[str, Callable[[], EnvironmentLight]]] = [
        ("one color", lambda: Environment(1000.0)),
        ("clear sky", lambda: Environment(Sky().image)),
        *((path.name, lambda path=path: Environment(path, rotation=1.5)) for path in files),
    ]
    frames: tuple[int, ...] = FRAMES
    if quick:
        skies = skies[:1]
        frames = (2,)
        size = (16, 16)
        samples = 4
        converged = 16
        seeds = 2
    with measuring(select, rays, markdown, "Portals", INTRO) as (device, report):
        rows = []
        for name, sky in skies:
            report.progress(name)
            rooms = [window_room(sky(), with_portal=with_portal) for with_portal in (False, True)]
            # A portal changes noise, not light: one reference serves both rooms.
            truths = path_traced(device, rooms[0], rooms[0].camera, size, converged, None)
            before, after = (_trace(device, room, truths, samples, seeds) for room in rooms)
            rows.append([name, f"path tracer, {samples} samples", *_cells(*before, *after)])
            spent = [milliseconds(device, room, size, [Settings()])[0] for room in rooms]
            found = [_frames(device, room, truths, frames, seeds) for room in rooms]
            for what, first, second in zip(_titles(frames), *found, strict=True):
                rows.append([name, what, *_cells(first, spent[0], second, spent[1])])
        report.table(f"A room with a window, {size[0]}x{size[1]}, {seeds} runs", HEAD, rows)


def window_room(environment: EnvironmentLight, *, with_portal: bool) -> Scene:
    """A room of 5 x 2.8 x 4 m whose only light comes through a window of 1 x 0.8 m."""
    scene = Scene(name="window_room")
    walls, wood = matte(0.7, "walls"), matte((0.5, 0.3, 0.2), "wood")
    for low, high in (
        ((-0.2, -0.2, -0.2), (5.2, 0, 4.2)),
        ((-0.2, 2.8, -0.2), (5.2, 3, 4.2)),
        ((-0.2, 0, -0.2), (5.2, 2.8, 0)),
        ((-0.2, 0, 4), (5.2, 2.8, 4.2)),
        ((-0.2, 0, 0), (0, 2.8, 4)),
        # around the window in the wall at x = 5
        ((5, 0, 0), (5.2, 1, 4)),
        ((5, 1.8, 0), (5.2, 2.8, 4)),
        ((5, 1, 0), (5.2, 1.8, 1.5)),
        ((5, 1, 2.5), (5.2, 1.8, 4)),
    ):
        scene.add(shapes.box(low, high), wood if high[1] == 0 else walls)
    scene.add(shapes.box((2.2, 0, 1.2), (3.4, 0.75, 2.4)), wood, name="table")
    scene.add(shapes.sphere(0.3), matte((0.2, 0.4, 0.7), "ball"), place(at=(2.8, 1.05, 1.8)), name="ball")
    scene.environment = environment
    if with_portal:
        scene.add(Portal(np.array((5.1, 1.4, 2)), rgb((0, 0.4, 0)), rgb((0, 0, 0.5)), name="window"))
    scene.add(Camera.look_at((0.4, 1.7, 3.6), (4, 0.9, 1.2), vertical_fov=1.0, ev100=7.0))
    return scene


def _trace(device: Device, scene: Scene, truths: Picture, samples: int, seeds: int) -> tuple[Errors, float]:
    """Errors of the path tracer's pictures (seeds,), and milliseconds of one."""
    errors = []
    spent = []
    with PathTracer(device, scene, (truths.shape[2], truths.shape[1])) as tracer:
        # Compiles, which would count for the first seed.
        tracer.render(samples=1)["radiance"]
        for seed in range(seeds):
            tracer.seed = SEED + seed
            start = time.perf_counter()
            # Reading the picture waits for the device.
            picture = np.asarray(tracer.render(samples=samples)["radiance"], np.float64)
            spent.append(1e3 * (time.perf_counter() - start))
            errors.append(true_relative_mse(picture, *truths))
    return np.array(errors), float(np.median(spent))


def _titles(frames: Sequence[int]) -> list[str]:
    return [f"{kind} frame {frame}" for frame in frames for kind in ("raw", "denoised")]


def _frames(device: Device, scene: Scene, truths: Picture, frames: Sequence[int], seeds: int) -> list[Errors]:
    """Errors (seeds,) of realtime frames, in the order of `_titles`."""
    case = Case("still", lambda frame: scene.camera, frames)
    # References are (2, height, width, 3).
    size = truths.shape[2], truths.shape[1]
    runs = [measure(device, scene, case, size, frames, Settings(), SEED + seed) for seed in range(seeds)]

    def errors(looks: Sequence[Look]) -> list[Errors]:
        raw = [true_relative_mse(look.raw, *truths) for look in looks]
        denoised = [true_relative_mse(look.denoised, *truths) for look in looks]
        return [np.array(raw), np.array(denoised)]

    return [found for looks in zip(*runs, strict=True) for found in errors(looks)]


def _cells(before: Errors, time_before: float, after: Errors, time_after: float) -> list[str]:
    ratio, width = interval(after / before)
    gain = after.mean() * time_after / (before.mean() * time_before)
    return [
        f"{before.mean():.3g}",
        f"{after.mean():.3g}",
        f"{ratio:.2f} ± {width:.2f}",
        f"{time_before:.1f}",
        f"{time_after:.1f}",
        f"{gain:.2f}",
    ]
