"""`solari-vk trial`."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from solari_vk.base.errors import SolariError
from solari_vk.cli.jobs import DeviceOptions, SceneOptions
from solari_vk.cli.options import count, factor, option, positive, size, words

if TYPE_CHECKING:
    from solari_vk.lab.trial.scene_files import TrialScene


@dataclass(frozen=True, kw_only=True)
class TrialJob(DeviceOptions):
    """The same scenes through other renderers."""

    DESCRIPTION: ClassVar = (
        "Render glTF files by the path tracer and by other renderers, with the same camera, environment and lights, "
        "and write a page of pictures, distances and times. Each renderer has a process of its own, so that a crash or "
        "a hang of one is a line of the page. Those that aren't installed are left out."
    )

    files: tuple[Path, ...] = option("glTF files, each a scene", names=("files",), nargs="+", type=Path)
    against: tuple[str, ...] = option(
        "the other renderers: cycles, mitsuba, luxcore (the first two)",
        "A,B",
        type=words,
        default=("cycles", "mitsuba"),
    )
    output: Path = option(
        "for the page, index.html, with trial.json and pictures; made if it isn't there",
        "FOLDER",
        names=("-o", "--output"),
        type=Path,
        required=True,
    )
    size: tuple[int, int] = option("width and height of pictures (256x256)", "WxH", type=size, default=(256, 256))
    samples: int = option("samples per pixel of each picture (256)", "N", type=positive, default=256)
    error: float | None = option(
        "measure the time to this error too, as relMSE: samples double up to --samples", "E", type=factor
    )
    max_bounces: int = option("surfaces that a path may leave (16)", "N", type=count, default=16)
    environment: str = option(
        "what surrounds the scenes; auto: what the file has, and soft boxes for files without light; never with a "
        "floor, which the other renderers don't have (auto)",
        "auto|studio|sky|none|FILE",
        default="auto",
    )
    camera: str | None = option("a camera of the scenes by index or name, or a pose, as for render", "N|NAME|JSON|FILE")
    python: tuple[str, ...] = option(
        "the Python that has a renderer (repeatable; SOLARI_VK_TRIAL_PYTHON, or the one that runs this)",
        "NAME=PATH",
        action="append",
        default=(),
    )
    time_limit: float = option(
        "seconds for loading and for each picture of a renderer, which is stopped then (600)",
        "S",
        type=factor,
        default=600.0,
    )
    markdown: Path | None = option("write the figures as Markdown too", "FILE", type=Path)

    def check(self) -> None:
        """Raise SolariError for files that aren't there, and for built-in scenes."""
        for file in self.files:
            if not os.path.isfile(file):  # False for names that no file can have
                raise SolariError(f"{file}: there is no such file: give glTF files, which all renderers can load")


def run(job: TrialJob) -> int:
    """Measure and write the page; returns the exit code."""
    # Imported late, so that the help needs none of it.
    from solari_vk.base.files import check_writable
    from solari_vk.lab.trial.compare import Goal
    from solari_vk.lab.trial.run import Plan, pythons_of
    from solari_vk.lab.trial.run import run as measure
    from solari_vk.lab.trial.scene_files import Conditions

    if job.markdown is not None:
        check_writable(job.markdown)
    plan = Plan(job.samples, [] if job.error is None else [Goal(job.error)], job.time_limit)
    conditions = Conditions(job.size, job.max_bounces, job.device, job.rays)
    pythons = pythons_of(job.python, os.environ.get("SOLARI_VK_TRIAL_PYTHON", sys.executable))
    measure(_scenes(job), job.against, plan, conditions, pythons, job.output, job.markdown)
    print(f"wrote {job.output / 'index.html'}")
    return 0


def _scenes(job: TrialJob) -> Iterator[TrialScene | tuple[str, SolariError]]:
    """The scenes, each with a name of its own; for one that can't be loaded its name and the error."""
    from solari_vk.cli.loading import load_scene
    from solari_vk.lab.trial.scene_files import TrialScene

    names: set[str] = set()
    for file in job.files:
        stem = re.sub(r"[^\w.-]", "_", file.stem)
        # Files of the same name in several folders get a number.
        name = next(n for n in (stem, *(f"{stem}-{i}" for i in range(2, len(job.files) + 2))) if n not in names)
        names.add(name)
        try:
            scene_of = SceneOptions(source=str(file), size=job.size, environment=job.environment, camera=job.camera)
            found = load_scene(scene_of)
        except SolariError as error:
            yield name, error
            continue
        # A backdrop of ours is in no file that the other renderers load.
        if found.scene.backdrop is not None:
            found.scene.remove(found.scene.backdrop)
        yield TrialScene(name, file, found.scene, found.cameras[0])
