"""`solari-vk bench settings`: errors and times of the realtime frame with settings beside those of the preset."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from solari_vk.errors import SolariError
from solari_vk.gpu.device.device import Device
from solari_vk.measure.denoised import MOTION, SEED, Case, cases, measure, path_traced
from solari_vk.measure.frame.passes import frame_times
from solari_vk.measure.report import measuring
from solari_vk.measure.statistics import interval, true_relative_mse
from solari_vk.measure.subjects import from_file
from solari_vk.renderer import Renderer
from solari_vk.scene.builtin import builtin
from solari_vk.scene.model import Scene
from solari_vk.settings import Settings

SCENES = ("cornell_box", "sphere_grid", "mirror_hall", "many_lights")
LOOKS = (8, MOTION)  # frames after a reset
INTRO = (
    "relMSE against the path tracer (its noise cancels out), of raw frames and of denoised ones, with the preset's "
    "settings (before) and with those named (after), and their ratios after / before; ± is half of the 95 % interval "
    "of the ratio over runs with different seeds. The last column is the ratio of denoised error x time of a settled "
    "frame: below 1 the settings pay."
)
HEAD = ("scene", "case", "frame", "raw, before", "after", "ratio", "denoised, before", "after", "ratio",
        "ms, before", "after", "error x time")  # fmt: skip


def run(
    select: str | None, files: Sequence[Path], *, rays: str | None = None, markdown: Path | None = None,
    change: Sequence[str] = (), size: tuple[int, int] = (256, 256), seeds: int = 4, samples: int = 4096,
    quick: bool = False,
) -> None:  # fmt: skip
    """Measure and print a table for each of `change`, KEY=VALUE[,KEY=VALUE...] each.

    size: of the pictures, (width, height). samples: of the path tracer's picture. quick: tiny pictures, the first scene
    standing still. Raises SolariError without changes, for unknown settings, and without a folder for the page.
    """
    if not change:
        raise SolariError("bench settings: name the settings to judge, such as --change restir=on")
    changed = [_settings(text) for text in change]
    looks = LOOKS
    if quick:
        size, seeds, samples, looks = (16, 16), 2, 16, (2,)
    scenes = [builtin(name) for name in SCENES[: 1 if quick else None]] + [from_file(path) for path in files]
    with measuring(select, rays, markdown, "Settings, judged", INTRO) as (device, report):
        tables: list[list[list[str]]] = [[] for _ in change]
        for scene in scenes:
            for case in list(cases(scene, size, max(looks)))[: 1 if quick else 3]:
                report.progress(f"{scene.name}, {case.name}")
                case = Case(case.name, case.place, looks if case.name == "still" else looks[-1:])
                before = _judge(device, scene, case, size, Settings(), seeds, samples)
                for rows, settings in zip(tables, changed, strict=True):
                    after = _judge(device, scene, case, size, settings, seeds, samples)
                    rows += [[scene.name, case.name, *row] for row in _rows(case, before, after)]
        for text, rows in zip(change, tables, strict=True):
            report.table(f"{text}, {size[0]}x{size[1]}, {seeds} runs", HEAD, rows)


def _settings(text: str) -> Settings:
    settings = Settings()
    for part in text.split(","):
        settings.update(part)
    return settings


def _judge(
    device: Device, scene: Scene, case: Case, size: tuple[int, int], settings: Settings, seeds: int, samples: int
) -> tuple[np.ndarray, float]:
    """Errors (looks, raw and denoised, seeds), and the milliseconds of a frame."""
    truths = path_traced(device, scene, case.place(max(case.looks) - 1), size, samples, None)
    errors = [[(true_relative_mse(look.raw, *truths), true_relative_mse(look.denoised, *truths)) for look in looks]
              for looks in (measure(device, scene, case, size, case.looks, settings, SEED + i) for i in range(seeds))]
    with Renderer(device, scene, size, settings, seed=SEED) as renderer:
        spent = frame_times(renderer, case.place(max(case.looks) - 1), 16, 32)["frame"]
    return np.array(errors).transpose(1, 2, 0), spent


def _rows(case: Case, before: tuple[np.ndarray, float], after: tuple[np.ndarray, float]) -> list[list[str]]:
    rows = []
    for look, old, new in zip(case.looks, before[0], after[0], strict=True):
        cells = [str(look)]
        for sooner, later in zip(old, new, strict=True):  # raw, denoised
            mean, width = interval(later / sooner.mean())
            cells += [f"{sooner.mean():.3g}", f"{later.mean():.3g}", f"{mean:.2f} ± {width:.2f}"]
        times = before[1], after[1]
        gain = new[1].mean() * times[1] / (old[1].mean() * times[0])
        rows.append([*cells, *(f"{time:.2f}" for time in times), f"{gain:.2f}"])
    return rows
