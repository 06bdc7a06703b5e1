"""`solari-vk render --animate` with several devices, a shutter, or by the path tracer: pictures, and their movie."""

from __future__ import annotations

import copy
import dataclasses
import shutil
import sys
from typing import TYPE_CHECKING

from solari_vk.base.errors import SolariError
from solari_vk.base.files import make_folder
from solari_vk.cli.devices import open_pool
from solari_vk.cli.jobs import ANIMATION_AVERAGE, EXPOSED_AVERAGE, MovieJob
from solari_vk.cli.loading import LoadedScene, set_exposure
from solari_vk.data.cli.rendering import metered, render_files
from solari_vk.data.sensors.sensor import Sensor
from solari_vk.output.movie import write_movie
from solari_vk.scene.shutter import Shutter, between
from solari_vk.settings import Settings

if TYPE_CHECKING:
    from solari_vk.data.cluster import View


def run(job: MovieJob, loaded: LoadedScene, how: Settings | int) -> int:
    """Render the pictures that aren't there yet; returns the exit code, 1 if some are missing.

    how: settings of the realtime renderer, or the path tracer's samples per pixel. The pictures of a movie are in a
    folder beside it until it is written.
    """
    from solari_vk.data.cluster import RenderTask, Style, blocks
    from solari_vk.data.datasets.journal import open_journal
    from solari_vk.data.datasets.tasks import RAW

    output = job.output.resolve()
    folder = output.with_name(f"{output.stem}.frames") if job.is_movie else output.parent
    make_folder(folder)
    clip = None if loaded.clip is None else list(loaded.scene.animations).index(loaded.clip)
    if isinstance(how, Settings):
        frames = job.average or (ANIMATION_AVERAGE if job.shutter is None else EXPOSED_AVERAGE)
        style = Style(job.size, job.seed, job.aov, job.tonemap, clip, how, frames, job.warm_up, shutter=_shutter(job))
    else:
        style = Style(
            job.size,
            job.seed,
            job.aov,
            job.tonemap,
            clip,
            samples=how,
            max_bounces=job.max_bounces,
            denoise=job.denoise,
            shutter=_shutter(job),
        )
    if job.sensor is not None:
        style = dataclasses.replace(style, sensor=Sensor.load(job.sensor), layers=(*style.layers, RAW))
    if style.clip is not None:
        loaded.scene.animate(0.0, style.clip)
    with open_pool(job) as pool:
        if loaded.auto_exposure:
            set_exposure(loaded.cameras, metered(pool, loaded, loaded.cameras[:1], job.size))
        views = _views(job, loaded, style.clip, ".png" if job.is_movie else output.suffix)
        if style.settings is None:
            tasks = [RenderTask(style, number, (view,)) for number, view in enumerate(views)]
        else:
            tasks = blocks(style, views)
        journal = open_journal(folder / f"{output.stem}.jsonl", pool, loaded.scene, tasks)
        complete = render_files(pool, loaded.scene, tasks, journal, job)
    if job.is_movie and complete:
        write_movie(output, [folder / view.name for view in views], job.fps)
        shutil.rmtree(folder)
        print(f"wrote {job.output}: EV100 {views[0].camera.ev100:.2f}", file=sys.stderr)
    return 0 if complete else 1


def _shutter(job: MovieJob) -> Shutter | None:
    if job.shutter is None:
        return None
    exposed, readout = job.shutter
    if exposed + readout > 1 / job.fps:
        raise SolariError(
            f"--shutter {exposed:g},{readout:g}: is longer than a picture at --fps {job.fps}, {1 / job.fps:.4g} s"
        )
    return Shutter(close=exposed, readout=readout)


def _views(job: MovieJob, loaded: LoadedScene, clip: int | None, suffix: str) -> list[View]:
    """The pictures, with the cameras as they are at their times: a clip may move them."""
    from solari_vk.data.cluster import View

    views, lasts = [], sum(job.shutter or ())
    for number, camera in enumerate(loaded.cameras):
        time = None if clip is None else number / job.fps
        if clip is not None and time is not None:
            loaded.scene.animate(time, clip)
        shown, closing = copy.deepcopy(camera), None
        if job.shutter is not None and clip is not None and time is not None:
            loaded.scene.animate(time + lasts, clip)
            closing = copy.deepcopy(camera)
        elif job.shutter is not None:
            share, last = lasts * job.fps, len(loaded.cameras) - 1
            if number < last:
                closing = between(shown, loaded.cameras[number + 1], share)
            elif last:
                closing = between(loaded.cameras[last - 1], shown, 1 + share)
        views.append(View(f"{job.output.stem}.{number:04}{suffix}", shown, time, closing))
    if clip is not None:
        loaded.scene.animate(0.0, clip)
    return views
