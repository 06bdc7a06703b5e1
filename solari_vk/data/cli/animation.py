"""`solari-vk render --animate` with several devices, a shutter, or by the path tracer: pictures, and their movie."""

from __future__ import annotations

import copy
import dataclasses
import sys
from contextlib import suppress

from solari_vk.base.errors import SolariError
from solari_vk.base.files import make_folder
from solari_vk.cli.devices import open_pool
from solari_vk.cli.jobs import ANIMATION_AVERAGE, EXPOSED_AVERAGE, MovieJob
from solari_vk.cli.loading import LoadedScene, set_exposure
from solari_vk.data.cli.rendering import metered, render_files
from solari_vk.data.datasets.journal import open_journal
from solari_vk.data.datasets.tasks import RAW, RenderTask, Style, View, blocks
from solari_vk.data.sensors.sensor import Sensor
from solari_vk.output.movie import write_movie
from solari_vk.scene.shutter import Shutter, between
from solari_vk.settings import Settings


def run(job: MovieJob, loaded: LoadedScene, how: Settings | int) -> int:
    """Render the pictures that aren't there yet; returns the exit code, 1 if some are missing.

    how: settings of the realtime renderer, or the path tracer's samples per pixel. The pictures of a movie are in a
    folder beside it until it is written.
    """
    output = job.output.resolve()
    folder = output.with_name(f"{output.stem}.frames") if job.is_movie else output.parent
    if job.is_movie and folder.is_symlink():
        raise SolariError(f"{folder}: is a link, where pictures of the movie would be written: remove it")
    make_folder(folder)
    style = _style(job, loaded, how)
    # Workers get the scene as it is here, so that its content, which the journal compares, doesn't depend on the pose
    # that was shown last.
    if style.clip is not None:
        loaded.scene.animate(0.0, style.clip)
    with open_pool(job) as pool:
        if loaded.auto_exposure:
            set_exposure(loaded.cameras, metered(pool, loaded, loaded.cameras[:1], job.size))
        suffix = ".png" if job.is_movie else output.suffix
        views = (
            _still_views(job, loaded, suffix) if style.clip is None else _clip_views(job, loaded, style.clip, suffix)
        )
        if style.settings is None:
            tasks = [RenderTask(style, number, (view,)) for number, view in enumerate(views)]
        else:
            tasks = blocks(style, views)
        journal = open_journal(folder / f"{output.stem}.jsonl", pool, loaded.scene, tasks)
        complete = render_files(pool, loaded.scene, tasks, journal, job)
    # The pictures of a movie go only once it is written; until then the next run goes on with them.
    if job.is_movie and complete:
        write_movie(output, [folder / view.name for view in views], job.fps)
        journal.remove(tasks)
        del journal  # and with it the lock's file
        # The folder stays if there is anything else in it.
        with suppress(OSError):
            folder.rmdir()
        print(f"wrote {job.output}: EV100 {views[0].camera.ev100:.2f}", file=sys.stderr)
    return 0 if complete else 1


def _style(job: MovieJob, loaded: LoadedScene, how: Settings | int) -> Style:
    """How the pictures are rendered; arguments are those of `run`."""
    clip = None if loaded.clip is None else list(loaded.scene.animations).index(loaded.clip)
    style = Style(job.size, job.seed, job.aov, job.tonemap, clip, shutter=_shutter(job))
    if isinstance(how, Settings):
        frames = job.average or (ANIMATION_AVERAGE if job.shutter is None else EXPOSED_AVERAGE)
        style = dataclasses.replace(style, settings=how, frames=frames, warm_up=job.warm_up)
    else:
        style = dataclasses.replace(style, samples=how, max_bounces=job.max_bounces, denoise=job.denoise)
    if job.sensor is not None:
        style = dataclasses.replace(style, sensor=Sensor.load(job.sensor), layers=(*style.layers, RAW))
    return style


def _shutter(job: MovieJob) -> Shutter | None:
    if job.shutter is None:
        return None
    exposed, readout = job.shutter
    # Two pictures would be exposed at once, which no camera does.
    if exposed + readout > 1 / job.fps:
        raise SolariError(
            f"--shutter {exposed:g},{readout:g}: is longer than a picture at --fps {job.fps}, {1 / job.fps:.4g} s"
        )
    return Shutter(close=exposed, readout=readout)


def _clip_views(job: MovieJob, loaded: LoadedScene, clip: int, suffix: str) -> list[View]:
    """The pictures of a clip, with the cameras as they are at their times: the clip may move them."""
    views = []
    exposed = sum(job.shutter or ())
    for number, camera in enumerate(loaded.cameras):
        time = number / job.fps
        loaded.scene.animate(time, clip)
        shown = copy.deepcopy(camera)
        closing = None
        if job.shutter is not None:
            loaded.scene.animate(time + exposed, clip)
            closing = copy.deepcopy(camera)
        views.append(View(_file_name(job, number, suffix), shown, time, closing))
    loaded.scene.animate(0.0, clip)
    return views


def _still_views(job: MovieJob, loaded: LoadedScene, suffix: str) -> list[View]:
    """The pictures of a scene that stands still, around which cameras move."""
    views = []
    cameras = loaded.cameras
    share = sum(job.shutter or ()) * job.fps  # of the way to the next camera, which the shutter is open for
    last = len(cameras) - 1
    for number, camera in enumerate(cameras):
        closing = None
        if job.shutter is not None and number < last:
            closing = between(camera, cameras[number + 1], share)
        elif job.shutter is not None and last:
            # After the last camera the motion goes on as it came there.
            closing = between(cameras[last - 1], camera, 1 + share)
        views.append(View(_file_name(job, number, suffix), copy.deepcopy(camera), None, closing))
    return views


def _file_name(job: MovieJob, number: int, suffix: str) -> str:
    return f"{job.output.stem}.{number:04}{suffix}"
