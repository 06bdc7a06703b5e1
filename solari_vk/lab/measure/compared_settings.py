"""`solari-vk bench settings`: errors and times of the realtime frame with settings beside those of the preset."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.base.files import make_folder
from solari_vk.gpu.device.device import Device
from solari_vk.lab.measure.denoised import MOTION, SCENES, SEED, Case, Picture, cases, measure, path_traced
from solari_vk.lab.measure.figures import interval
from solari_vk.lab.measure.report import Report, measuring
from solari_vk.lab.measure.scenes import from_file
from solari_vk.output.compare import true_relative_mse
from solari_vk.renderers.renderer import Renderer
from solari_vk.scene.builtin import builtin
from solari_vk.scene.model import Scene
from solari_vk.settings import Settings

Errors = NDArray[np.float64]
LOOKS = (1, 8, MOTION)  # frames after a reset
INTRO = (
    "relMSE against the path tracer (its noise cancels out), of raw frames and of denoised ones, with the preset's "
    "settings (before) and with those named (after), and their ratios after / before; ± is half of the 95 % interval "
    "of the ratio over runs with different seeds. ms: all passes of a settled frame, medians of frames in turns. The "
    "last columns are ratios of error x time: below 1 the settings pay."
)
HEAD = ("scene", "case", "frame", "raw, before", "after", "ratio", "denoised, before", "after", "ratio",
        "ms, before", "after", "raw error x time", "denoised error x time")  # fmt: skip


def run(
    select: str | None,
    files: Sequence[Path],
    *,
    rays: str | None = None,
    markdown: Path | None = None,
    base: str = "",
    change: Sequence[str] = (),
    scene: Sequence[str] = (),
    size: tuple[int, int] = (256, 256),
    timed_size: tuple[int, int] = (1920, 1080),
    seeds: int = 4,
    samples: int = 4096,
    references: Path | None = None,
    still: bool = False,
    quick: bool = False,
) -> None:
    """Measure and print a table for each of `change`, KEY=VALUE[,KEY=VALUE...] each.

    base: settings of both sides. scene: names of built-in scenes, by default SCENES. references: a folder that keeps
    the path tracer's pictures for the next run, for as long as the scenes are the same. still: no motion. size: of the
    pictures, (width, height). timed_size: of the frames whose time is taken. samples: of the path tracer's pictures.
    quick: tiny pictures, the first scene standing still. Raises SolariError without changes, for unknown scenes and
    settings, and without a folder for the page.
    """
    if not change:
        raise SolariError("bench settings: name the settings to compare, such as --change restir=on")
    compared = [_settings(base, text) for text in ("", *change)]
    plan = _Plan(size, timed_size, seeds, samples, LOOKS, 1 if still else 3)
    if quick:
        plan = _Plan((16, 16), (16, 16), 2, 16, (2,), 1)
    if references is not None:
        make_folder(references)
    scenes = [builtin(name) for name in scene or SCENES[: 1 if quick else None]] + [from_file(path) for path in files]
    with measuring(select, rays, markdown, "Settings, judged", INTRO) as (device, report):
        tables: list[list[list[str]]] = [[] for _ in change]
        for measured in scenes:
            for rows, more in zip(tables, _rows(device, report, measured, compared, plan, references), strict=True):
                rows += more
        for text, rows in zip(change, tables, strict=True):
            shared = f", both with {base}" if base else ""
            sizes = "{}x{}, {} runs, timed at {}x{}".format(*plan.size, plan.seeds, *plan.timed_size)
            report.table(f"{text}{shared}, {sizes}", HEAD, rows)


@dataclass(frozen=True)
class _Plan:
    """How much is measured: the arguments of `run`, the frames that are looked at, and the number of cases."""

    size: tuple[int, int]
    timed_size: tuple[int, int]
    seeds: int
    samples: int
    looks: tuple[int, ...]
    cases: int


def _rows(
    device: Device, report: Report, scene: Scene, compared: Sequence[Settings], plan: _Plan, references: Path | None
) -> list[list[list[str]]]:
    """The rows of a scene, for each of the compared settings but the first, which the others are held against."""
    # The first settings are measured once for all that they are compared with.
    tables: list[list[list[str]]] = [[] for _ in compared[1:]]
    time_before, *times = milliseconds(device, scene, plan.timed_size, compared)
    for case in list(cases(scene, plan.size, max(plan.looks)))[: plan.cases]:
        name = f"{scene.name}, {case.name}"
        report.progress(name)
        reference_file = references and references / f"{name}, {plan.size[0]}x{plan.size[1]}.npz"
        # In motion only the last frame's camera has a reference.
        case = replace(case, looks=plan.looks if case.name == "still" else plan.looks[-1:])
        truths = path_traced(device, scene, case.place(max(case.looks) - 1), plan.size, plan.samples, reference_file)
        before, *others = (_errors(device, scene, case, truths, settings, plan.seeds) for settings in compared)
        for rows, after, time in zip(tables, others, times, strict=True):
            for look, old, new in zip(case.looks, before, after, strict=True):
                rows.append([scene.name, case.name, str(look), *_cells(old, new, time_before, time)])
    return tables


def _settings(*texts: str) -> Settings:
    settings = Settings()
    for part in ",".join(texts).split(","):
        if part:
            settings.update(part)
    return settings


def milliseconds(
    device: Device, scene: Scene, size: tuple[int, int], every: Sequence[Settings], warm_up: int = 16, frames: int = 32
) -> list[float]:
    """Of all passes of a settled frame with each of the settings. Frames take turns, so that other work of the machine
    slows all settings."""
    camera = scene.camera_for(size[0] / size[1])
    spent = []
    with ExitStack() as stack:
        renderers = [stack.enter_context(Renderer(device, scene, size, one, seed=SEED)) for one in every]
        for _ in range(warm_up + frames):
            for renderer in renderers:
                renderer.render(camera)["radiance"]
                spent.append(sum(renderer.timings.values()))
    return [float(time) for time in np.median(np.reshape(spent, (-1, len(every)))[warm_up:], axis=0)]


def _errors(device: Device, scene: Scene, case: Case, truths: Picture, settings: Settings, seeds: int) -> Errors:
    """Errors (looks, raw and denoised, seeds)."""
    # References are (2, height, width, 3).
    size = truths.shape[2], truths.shape[1]
    errors = []
    for seed in range(SEED, SEED + seeds):
        looks = measure(device, scene, case, size, case.looks, settings, seed)
        pairs = [(look.raw, look.denoised) for look in looks]
        errors.append([[true_relative_mse(picture, *truths) for picture in pair] for pair in pairs])
    return np.array(errors).transpose(1, 2, 0)


def _cells(before: Errors, after: Errors, time_before: float, time_after: float) -> list[str]:
    """Of errors (raw and denoised, seeds)."""
    cells = []
    for old, new in zip(before, after, strict=True):
        mean, width = interval(new / old)  # of the same seeds
        cells += [f"{old.mean():.3g}", f"{new.mean():.3g}", f"{mean:.2f} ± {width:.2f}"]
    # The error of a path tracer falls as one over its time, so the product tells whether the settings pay.
    gains = after.mean(axis=1) * time_after / (before.mean(axis=1) * time_before)
    return [*cells, f"{time_before:.2f}", f"{time_after:.2f}", *(f"{gain:.2f}" for gain in gains)]
