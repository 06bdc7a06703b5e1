"""`solari-vk render --animate` with several devices: blocks of pictures, and a movie of them."""

from __future__ import annotations

import argparse
import copy
import shutil
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from solari_vk.cli.cluster import open_pool, render_files
from solari_vk.cli.plan import ANIMATION_AVERAGE
from solari_vk.cli.subject import Subject
from solari_vk.errors import SolariError
from solari_vk.files import make_folder
from solari_vk.output.movie import write_movie
from solari_vk.settings import Settings

if TYPE_CHECKING:
    from solari_vk.cluster import View


def run(
    options: argparse.Namespace, subject: Subject, names: list[str], settings: Settings, is_movie: bool
) -> int:
    """Render the pictures that aren't there yet; returns the exit code, 1 if some are missing.

    Those of a movie are in a folder beside it until it is written.
    """
    from solari_vk.cluster import Meter, Style, blocks
    from solari_vk.cluster.journal import open_journal

    output: Path = options.output.resolve()
    folder = output.with_name(f"{output.stem}.frames") if is_movie else output.parent
    make_folder(folder)
    style = Style(
        options.size, options.seed, tuple(names), options.tonemap, settings=settings, warm_up=options.warm_up,
        clip=None if subject.clip is None else list(subject.scene.animations).index(subject.clip),
        frames=options.average or ANIMATION_AVERAGE,
    )  # fmt: skip
    if style.clip is not None:
        subject.scene.animate(0.0, style.clip)
    with open_pool(options) as pool:
        if subject.auto_exposure:
            meter = Meter((subject.cameras[0],), options.size)
            ev100 = next(done[1] for done in pool.map(subject.scene, [meter]) if done is not None)
            for camera in subject.cameras:
                camera.ev100 = ev100
        views = _views(options, subject, style.clip, ".png" if is_movie else output.suffix)
        tasks = blocks(style, views)
        journal = open_journal(folder / f"{output.stem}.jsonl", pool, subject.scene, tasks)
        complete = render_files(pool, subject.scene, tasks, journal, options)
    if is_movie and complete:
        write_movie(output, [folder / view.name for view in views], options.fps)
        shutil.rmtree(folder)
        print(f"wrote {options.output}: EV100 {views[0].camera.ev100:.2f}", file=sys.stderr)
    return 0 if complete else 1


def check(options: argparse.Namespace) -> None:
    """Raise SolariError for what can't be divided among devices."""
    if options.animate is None:
        raise SolariError("a still picture in realtime mode is made by one device: give --mode reference or --animate, "
                          "or leave --workers and --cluster out")  # fmt: skip
    if options.view != "picture":
        raise SolariError(f"--view {options.view}: debug views are rendered by one device: leave --workers and "
                          "--cluster out")  # fmt: skip


def _views(options: argparse.Namespace, subject: Subject, clip: int | None, suffix: str) -> list[View]:
    """The pictures, with the cameras as they are at their times: a clip may move them."""
    from solari_vk.cluster import View

    views = []
    for number, camera in enumerate(subject.cameras):
        time = None if clip is None else number / options.fps
        if clip is not None and time is not None:
            subject.scene.animate(time, clip)
        views.append(View(f"{options.output.stem}.{number:04}{suffix}", copy.deepcopy(camera), time))
    if clip is not None:
        subject.scene.animate(0.0, clip)
    return views
