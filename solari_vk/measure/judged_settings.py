"""`solari-vk bench settings`: errors and times of the realtime frame with settings beside those of the preset."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from solari_vk.errors import SolariError
from solari_vk.gpu.device.device import Device
from solari_vk.measure.denoised import MOTION, SCENES, SEED, Case, Picture, cases, measure, path_traced
from solari_vk.measure.frame.passes import frame_times
from solari_vk.measure.report import measuring
from solari_vk.measure.statistics import interval, true_relative_mse
from solari_vk.measure.subjects import from_file
from solari_vk.renderer import Renderer
from solari_vk.scene.builtin import builtin
from solari_vk.scene.model import Scene
from solari_vk.settings import Settings

Errors = NDArray[np.float64]
LOOKS = (8, MOTION)  # frames after a reset
INTRO = (
    "relMSE against the path tracer (its noise cancels out), of raw frames and of denoised ones, with the preset's "
    "settings (before) and with those named (after), and their ratios after / before; ± is half of the 95 % interval "
    "of the ratio over runs with different seeds. ms: all passes of a settled frame. The last column is the ratio of "
    "denoised error x time: below 1 the settings pay."
)
HEAD = ("scene", "case", "frame", "raw, before", "after", "ratio", "denoised, before", "after", "ratio",
        "ms, before", "after", "error x time")  # fmt: skip


def run(
    select: str | None, files: Sequence[Path], *, rays: str | None = None, markdown: Path | None = None,
    base: str = "", change: Sequence[str] = (), size: tuple[int, int] = (256, 256),
    timed_size: tuple[int, int] = (1920, 1080), seeds: int = 4, samples: int = 4096, quick: bool = False,
) -> None:  # fmt: skip
    """Measure and print a table for each of `change`, KEY=VALUE[,KEY=VALUE...] each.

    base: settings of both sides. size: of the pictures, (width, height). timed_size: of the frames whose time is taken.
    samples: of the path tracer's pictures. quick: tiny pictures, the first scene standing still. Raises SolariError
    without changes, for unknown settings, and without a folder for the page.
    """
    if not change:
        raise SolariError("bench settings: name the settings to judge, such as --change restir=on")
    unchanged, *changed = (_settings(base, text) for text in ("", *change))
    looks: tuple[int, ...] = LOOKS
    if quick:
        size, timed_size, seeds, samples, looks = (16, 16), (16, 16), 2, 16, (2,)
    scenes = [builtin(name) for name in SCENES[: 1 if quick else None]] + [from_file(path) for path in files]
    with measuring(select, rays, markdown, "Settings, judged", INTRO) as (device, report):
        tables: list[list[list[str]]] = [[] for _ in change]
        for scene in scenes:
            spent, *times = (_milliseconds(device, scene, timed_size, settings) for settings in (unchanged, *changed))
            for case in list(cases(scene, size, max(looks)))[: 1 if quick else 3]:
                report.progress(f"{scene.name}, {case.name}")
                case = Case(case.name, case.place, looks if case.name == "still" else looks[-1:])
                truths = path_traced(device, scene, case.place(max(case.looks) - 1), size, samples, None)
                before = _judge(device, scene, case, truths, unchanged, seeds)
                for rows, settings, time in zip(tables, changed, times, strict=True):
                    after = _judge(device, scene, case, truths, settings, seeds)
                    for look, old, new in zip(case.looks, before, after, strict=True):
                        rows.append([scene.name, case.name, str(look), *_cells(old, new, spent, time)])
        for text, rows in zip(change, tables, strict=True):
            given = f", both with {base}" if base else ""
            sizes = f"{size[0]}x{size[1]}, {seeds} runs, timed at {timed_size[0]}x{timed_size[1]}"
            report.table(f"{text}{given}, {sizes}", HEAD, rows)


def _settings(*texts: str) -> Settings:
    settings = Settings()
    for part in ",".join(texts).split(","):
        if part:
            settings.update(part)
    return settings


def _milliseconds(device: Device, scene: Scene, size: tuple[int, int], settings: Settings) -> float:
    """Of all passes of a settled frame."""
    with Renderer(device, scene, size, settings, seed=SEED) as renderer:
        times = frame_times(renderer, scene.camera_for(size[0] / size[1]), 16, 32)
    return sum(time for name, time in times.items() if name != "frame")


def _judge(device: Device, scene: Scene, case: Case, truths: Picture, settings: Settings, seeds: int) -> Errors:
    """Errors (looks, raw and denoised, seeds)."""
    size = truths.shape[2], truths.shape[1]
    errors = [[(true_relative_mse(look.raw, *truths), true_relative_mse(look.denoised, *truths)) for look in looks]
              for looks in (measure(device, scene, case, size, case.looks, settings, SEED + i) for i in range(seeds))]
    return np.array(errors).transpose(1, 2, 0)


def _cells(before: Errors, after: Errors, time_before: float, time_after: float) -> list[str]:
    """Of errors (raw and denoised, seeds)."""
    cells = []
    for old, new in zip(before, after, strict=True):
        mean, width = interval(new / old)  # of the same seeds
        cells += [f"{old.mean():.3g}", f"{new.mean():.3g}", f"{mean:.2f} ± {width:.2f}"]
    gain = after[1].mean() * time_after / (before[1].mean() * time_before)
    return [*cells, f"{time_before:.2f}", f"{time_after:.2f}", f"{gain:.2f}"]
