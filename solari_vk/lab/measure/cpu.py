"""`solari-vk bench cpu`: processor time to an error on a device without a GPU, beside other renderers."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from solari_vk.base.errors import SolariError
from solari_vk.base.files import make_temporary_folder
from solari_vk.lab.measure.report import measuring
from solari_vk.lab.trial import scene_files
from solari_vk.lab.trial.compare import Comparison, Goal, Result, compare
from solari_vk.lab.trial.process import CHILD, KINDS, OURS, Failure, Kind, Process
from solari_vk.lab.trial.run import present, pythons_of
from solari_vk.lab.trial.scene_files import Conditions, TrialScene
from solari_vk.scene.builtin import builtin

SCENES = ("cornell_box", "many_lights", "sphere_grid", "mirror_hall", "shiny_floor", "lamp_gap")
COARSE = Goal(1e-2)
FINE = Goal(1e-3)
DENOISED = Goal(5e-3, denoised=True)
FRAMES = 24
REALTIME = {"realtime": Kind("solari_vk, realtime", "in_realtime", OURS)}
INTRO = (
    "Processor seconds until the relMSE of a picture is small enough, of all threads, without loading and compiling. "
    "Renderers take turns, each figure is the median of three runs, and each is judged by its own converged picture. "
    "Samples double until the goal is met; times of raw pictures are brought to exactly the goal, by the error, which "
    "falls as one over the samples. Denoised: by Intel Open Image Denoise, with the renderer's own guides.",
    f"In motion the camera turns by half a degree each frame: the relMSE of frame {FRAMES} against the path tracer's "
    "picture, beside what the others' raw pictures have after as many processor seconds (by the same rule, also where "
    "that is less than one sample).",
)
HEAD = (
    "scene and renderer",
    f"to {COARSE.error:g}",
    f"to {FINE.error:g}",
    f"denoised, to {DENOISED.error:g}",
    "over ours",
    "in motion, at equal time",
)


def run(
    select: str | None,
    against: Sequence[str],
    python: Sequence[str],
    size: tuple[int, int],
    samples: int,
    scenes: Sequence[str],
    time_limit: float,
    markdown: Path | None,
    *,
    rays: str | None = None,
    child: Path = CHILD,
) -> None:
    """Measure and report. samples: of the converged pictures, and the most that are tried. scenes: names of built-in
    ones. time_limit: seconds for each picture. Other arguments are those of `solari-vk trial`."""
    pythons = pythons_of(python, os.environ.get("SOLARI_VK_TRIAL_PYTHON", sys.executable))
    used, _ = present(against, pythons)
    conditions = Conditions(size, 16, select, rays)
    with measuring(select, rays, markdown, "Without a GPU", *INTRO) as (_, report):
        for name in scenes or SCENES:
            report.progress(name)
            folder = make_temporary_folder()
            start = {kind: partial(Process, kind, folder, time_limit, pythons[kind], child=child) for kind in used}
            try:
                scene = builtin(name)
                file = folder / "scene.glb"
                scene.save(file)
                scene_files.write(TrialScene(name, file, scene, scene.camera), conditions, folder)
                found = compare(start, samples, (COARSE, FINE, DENOISED), report.progress)
                if OURS not in found.results:
                    raise SolariError(f"bench cpu: {name}: {found.failures[OURS]}")
                report.progress("solari_vk, realtime")
                motion = _motion(found.results[OURS], folder, time_limit, child)
            finally:
                shutil.rmtree(folder, ignore_errors=True)
            report.table(
                f"{name}, {size[0]}x{size[1]}",
                HEAD,
                rows(found, motion),
                *(f"{KINDS[kind].title}: {failure}" for kind, failure in found.failures.items()),
            )


def _motion(ours: Result, folder: Path, limit: float, child: Path) -> tuple[float, float] | str:
    """The relMSE of a frame in motion and the processor seconds that it takes, or why there is none."""
    try:
        process = Process("realtime", folder, limit, kinds=REALTIME, child=child)
        try:
            process.render(FRAMES, 1)  # compiles what only frames with a history need
            done = process.render(FRAMES, 2)
        finally:
            process.close()
    except Failure as failure:
        return str(failure)
    return ours.error(done.picture), done.processor_seconds / FRAMES


def rows(found: Comparison, motion: tuple[float, float] | str) -> list[list[str]]:
    """The cells below HEAD."""
    # The ratio to ours is that of raw pictures.
    table = []
    ours = _seconds(found.results[OURS], COARSE)
    for name, result in found.results.items():
        coarse, fine, denoised = (_seconds(result, goal) for goal in (COARSE, FINE, DENOISED))
        known = _seconds(result, COARSE, FINE)
        cells = ["" if value is None else f"{value:.2f}" for value in (coarse, fine, denoised)]
        ratio = "" if coarse is None or ours is None else f"{coarse / ours:.2f}"
        # A raw picture's error times its processor time is constant: this is its error after the time of one frame.
        at_once = "" if known is None or isinstance(motion, str) else f"{known * COARSE.error / motion[1]:.2g}"
        table.append([KINDS[name].title, *cells, ratio, at_once])
    if isinstance(motion, str):
        return [*table, [f"{REALTIME['realtime'].title}: {motion}", *[""] * 5]]
    return [*table, [REALTIME["realtime"].title, *[""] * 4, f"{motion[0]:.2g} ({motion[1]:.2f} s a frame)"]]


def _seconds(result: Result, goal: Goal, other: Goal | None = None) -> float | None:
    """Processor seconds to a goal; None if it wasn't reached. other: one that counts too, if this one wasn't."""
    reached = result.reached.get(goal)
    if reached is None and other is not None:
        reached = result.reached.get(other)
    if reached is None:
        return None
    # The squared error of a path tracer falls as one over the samples; a denoiser's doesn't.
    return reached.processor_seconds * (1.0 if goal.denoised else reached.error / goal.error)
