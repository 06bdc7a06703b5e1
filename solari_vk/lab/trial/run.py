"""The trial: scenes through all renderers that are there, and its page."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from solari_vk.base.errors import SolariError, unknown_name
from solari_vk.base.files import followed, make_folder, make_temporary_folder, write_whole
from solari_vk.lab.page import host_load, run_facts
from solari_vk.lab.trial import scene_files
from solari_vk.lab.trial.compare import Comparison, Goal, compare
from solari_vk.lab.trial.differences import that_apply
from solari_vk.lab.trial.page import Page
from solari_vk.lab.trial.process import CHILD, KINDS, OURS, Process
from solari_vk.lab.trial.scene_files import Conditions, TrialScene
from solari_vk.output.tone_mapping import auto_exposure


@dataclass(frozen=True)
class Plan:
    """How to render: the samples of pictures, the errors to which times are measured, and seconds that loading and each
    picture may take."""

    samples: int
    goals: Sequence[Goal]
    limit: float


def pythons_of(texts: Sequence[str], default: str) -> dict[str, str]:
    """The Python of each renderer, from texts such as cycles=/path/to/python. Raises SolariError for others."""
    found = dict.fromkeys(KINDS, default) | {OURS: sys.executable}
    for text in texts:
        name, equals, path = text.partition("=")
        if not (equals and path):
            raise SolariError(f"--python {text}: give a renderer and its Python, such as cycles=venv/bin/python")
        if name not in KINDS:
            raise unknown_name("--python: there is no renderer", name, KINDS)
        found[name] = path
    return found


def present(others: Sequence[str], pythons: Mapping[str, str]) -> tuple[list[str], dict[str, str]]:
    """Ours and the others that can be used, and why the rest can't. Raises SolariError for unknown renderers."""
    for name in others:
        if name not in KINDS or name == OURS:
            raise unknown_name("--against: there is no renderer", name, [name for name in KINDS if name != OURS])
    reasons = {name: KINDS[name].missing(pythons[name]) for name in others}
    absent = {name: reason for name, reason in reasons.items() if reason}
    for name, why in absent.items():
        print(f"{KINDS[name].title} is left out: {why}", flush=True)
    return [OURS, *(name for name in others if name not in absent)], absent


def run(
    scenes: Iterator[TrialScene | tuple[str, SolariError]],
    others: Sequence[str],
    plan: Plan,
    conditions: Conditions,
    pythons: Mapping[str, str],
    folder: Path,
    markdown: Path | None = None,
    child: Path = CHILD,
) -> Page:
    """Measure all scenes and write the page after each; one that can't be loaded is its name and the error.

    Raises SolariError for unknown renderers, and if the page can't be written.
    """
    used, absent = present(others, pythons)
    width, height = conditions.size
    facts = run_facts() | {
        "size": f"{width}x{height}, {plan.samples} samples, {conditions.max_bounces} bounces",
        "error": ", ".join(f"relMSE {goal.error:g}" for goal in plan.goals) or "times not measured",
        "load of the host before": host_load(),
    }
    page = Page(folder, facts, absent)
    for item in scenes:
        if isinstance(item, TrialScene):
            print(f"{item.file}", flush=True)
            found = measure(item, used, plan, conditions, pythons, folder / item.name, child)
            page.add(item.name, found, [d for d in that_apply(item.scene) if d.renderer in (*used, "all")])
        else:
            name, error = item
            page.add(name, Comparison(failures={OURS: str(error)}), ())
        if markdown is not None:
            # Again after each scene, so that a run that is stopped leaves what it has.
            write_whole(followed(markdown), page.markdown())
    return page


def measure(
    item: TrialScene,
    renderers: Sequence[str],
    plan: Plan,
    conditions: Conditions,
    pythons: Mapping[str, str],
    folder: Path,
    child: Path = CHILD,
    progress: Callable[[str], None] = lambda text: print(f"  {text}", flush=True),
) -> Comparison:
    """Render a scene by all renderers; what they print stays in the folder, as NAME.log."""
    make_folder(folder)
    work = make_temporary_folder()
    try:
        try:
            scene_files.write(item, conditions, work)
        except SolariError as error:
            return Comparison(failures={OURS: str(error)})
        start = {name: partial(Process, name, work, plan.limit, pythons[name], child=child) for name in renderers}
        found = compare(start, plan.samples, plan.goals, progress)
        for log in work.glob("*.log"):
            shutil.copy(log, folder)
    finally:
        # Arrays of all meshes and textures: nobody needs them after the run.
        shutil.rmtree(work, ignore_errors=True)
    if found.results:
        # All pictures of a scene have one exposure, so that they can be compared.
        shown = found.results.get(OURS) or next(iter(found.results.values()))
        # A picture is white at 1.2 * 2^EV100 cd/m^2.
        found.exposure = float(1 / (1.2 * np.exp2(auto_exposure(shown.picture))))
    return found
