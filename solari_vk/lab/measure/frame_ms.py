"""`solari-vk bench frame-ms`: how well the setting `frame_ms` keeps frames to a time, with cuts among them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.gpu.device.device import Device
from solari_vk.lab.measure.denoised import SEED
from solari_vk.lab.measure.report import measuring
from solari_vk.renderers.renderer import Renderer
from solari_vk.scene.builtin import builtin
from solari_vk.scene.model import Scene
from solari_vk.settings import Settings

SCENES = ("cornell_box", "sphere_grid", "many_lights", "rooms")
WARM_UP = 60
CUTS = 4
AFTER = 8
"""Frames after a cut, most of whose pixels have short histories."""
INTRO = (
    "Times of frames on the device with `frame_ms`, all passes together, of a still camera with a cut (a reset) at the "
    f"start of each quarter, after {WARM_UP} frames that don't count. The setting is to hold the 95th percentile (p95) "
    "of all frames. Row 0: without it. First: the first frame after a cut, the longest of them."
)
HEAD = (
    "scene",
    "frame_ms",
    "median",
    "p95",
    "over frame_ms",
    f"p95 of the {AFTER} after cuts",
    "of the others",
    "first",
)


def run(
    select: str | None,
    *,
    rays: str | None = None,
    markdown: Path | None = None,
    scene: Sequence[str] = (),
    target: Sequence[float] = (),
    size: tuple[int, int] = (1920, 1080),
    frames: int = 400,
) -> None:
    """Measure and print a table. scene: names of built-in scenes, by default SCENES. target: values of `frame_ms`,
    milliseconds; by default 3/4 and 1 of the p95 of a scene's frames that don't follow a cut. size: (width, height) of
    the frames. frames: that count. Raises SolariError for unknown scenes, for fewer frames than cuts need, and without
    a folder for the page."""
    least = CUTS * (AFTER + 1)
    if frames < least:
        raise SolariError(f"bench frame-ms: {frames} frames with {CUTS} cuts; take at least {least}")
    scenes = [builtin(name) for name in scene or SCENES]
    with measuring(select, rays, markdown, "Frames of a given time", INTRO) as (device, report):
        rows = []
        for measured in scenes:
            report.progress(measured.name)
            free = milliseconds(device, measured, size, 0.0, frames)
            # Frames after a cut have more paths; the aims are those of the others.
            p95 = np.quantile(free.reshape(CUTS, -1)[:, AFTER:], 0.95)
            aims = target or (round(0.75 * p95, 1), round(p95, 1))
            rows.append(_row(measured.name, 0.0, free))
            rows += [_row(measured.name, aim, milliseconds(device, measured, size, aim, frames)) for aim in aims]
        report.table(f"{frames} frames of {size[0]}x{size[1]}, milliseconds", HEAD, rows)


def milliseconds(device: Device, scene: Scene, size: tuple[int, int], aim: float, frames: int) -> NDArray[np.float64]:
    """Of each frame's passes, (frames rounded down to a multiple of CUTS); every quarter begins with a reset."""
    camera = scene.camera_for(size[0] / size[1])
    spent = []
    with Renderer(device, scene, size, Settings(frame_ms=aim), seed=SEED) as renderer:
        # Each part begins with a cut; the first one lets the setting find its paths a pixel.
        for part in [WARM_UP] + CUTS * [frames // CUTS]:
            renderer.reset()
            for _ in range(part):
                renderer.render(camera)
                spent.append(sum(renderer.timings.values()))
    return np.array(spent[WARM_UP:])


def _row(name: str, aim: float, spent: NDArray[np.float64]) -> list[str]:
    early, late = np.hsplit(spent.reshape(CUTS, -1), [AFTER])
    p95, after, others = (float(np.quantile(part, 0.95)) for part in (spent, early, late))
    ratio = f"{p95 / aim:.2f}" if aim else ""
    figures = (f"{ms:.2f}" for ms in (after, others, early[:, 0].max()))
    return [name, f"{aim:g}", f"{np.median(spent):.2f}", f"{p95:.2f}", ratio, *figures]
