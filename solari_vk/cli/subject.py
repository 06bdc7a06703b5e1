"""What a command renders: the scene, the cameras and the exposure."""

from __future__ import annotations

import json
import math
import re
import sys
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import solari_vk as sv
from solari_vk.base.errors import SolariError, advice_for, quoted
from solari_vk.base.files import read_json
from solari_vk.cli.jobs import MovieJob, SceneOptions, StillJob
from solari_vk.output.animation import MAX_CAMERAS, load_path, orbit, orbit_turns
from solari_vk.scene.files.libraries import INSTALL
from solari_vk.scene.model import Animation, Camera, Scene
from solari_vk.scene.presenting.surroundings import surround
from solari_vk.scene.shutter import Shutter

ORBIT_PICTURES = 48
MAX_DIGITS = 10  # of an index: Python refuses to read numbers with thousands


def check_aovs(names: Sequence[str], mode: str, known: Sequence[str]) -> None:
    """Raise SolariError for a name that isn't among the outputs of a mode."""
    for name in names:
        if name not in known:
            there = advice_for("--aov", name) or f"it has {', '.join(known)}"
            raise SolariError(f"--aov {name}: --mode {mode} has no such output; {there}")


def expose(cameras: Iterable[Camera], ev100: float) -> None:
    """Give cameras one exposure."""
    for camera in cameras:
        camera.ev100 = ev100


@dataclass
class Subject:
    """A scene, and how to look at it."""

    scene: Scene
    cameras: list[Camera]
    """One camera, or those of an animation."""
    auto_exposure: bool
    """Whether the picture chooses the exposure, not the cameras."""
    clip: Animation | None
    """What --animate file plays."""
    still: Animation | None = None
    """The clip of which --time chose the pose."""


def load(
    job: SceneOptions, *, clip: str | None = None, time: float | None = None, seen_all_round: bool = False
) -> Subject:
    """The scene, the cameras and the exposure of a job; a still one is posed as it is at a time in a clip.

    seen_all_round: cameras will go around the scene, so that what frames it must do so from all sides.
    """
    movie = job if isinstance(job, MovieJob) else None
    builtin = job.source.startswith("builtin:")
    scene = _load_scene(job)
    still = None
    played = _find_clip(scene, job.source, clip, time, movie is not None and movie.animate == "file")
    if played is not None and time is not None:
        played.apply(scene, time, loop=False)
        still, played = played, None
    sweep = (None,) if seen_all_round else None if movie is None else _sweep(movie)
    turns = (0.0,) if sweep is None else orbit_turns(ORBIT_PICTURES, *sweep).tolist()
    front = scene.camera_for(job.size[0] / job.size[1], played, turns=turns)
    camera = front if job.camera is None else _find_camera(scene, job.camera)
    # Before added lights widen the scene's bounds:
    cameras = [camera] if movie is None else _path(movie, scene, camera, played, sweep)
    given, in_studio = surround(scene, front, job.environment)  # by `front`: --camera doesn't turn the light
    if getattr(job, "transparent", False):
        if any(shown.aperture for shown in cameras):
            raise SolariError(
                "--transparent: the camera has an aperture, whose blurred edges have no alpha: give "
                "--camera without one"
            )
        if scene.backdrop is not None:
            scene.backdrop.visible = False
    if given:
        print(f"{job.source} has no light of its own: it is {given}", file=sys.stderr)
    if job.environment_rotation or job.environment_intensity != 1:
        if scene.environment is None:
            raise SolariError(
                "--environment-rotation and -intensity: there is no environment: give one by --environment"
            )
        scene.environment.turn(math.radians(job.environment_rotation))
        scene.environment.intensity *= job.environment_intensity
    chosen = builtin or in_studio or (camera.has_exposure and not camera.auto_exposure)
    exposure = job.exposure or ("camera" if chosen else "auto")
    if exposure == "camera":
        for shown in cameras:
            shown.ev100 = float(shown.ev100)  # counts as set now: the light was made for it
    elif exposure != "auto":
        try:
            expose(cameras, float(exposure))
        except ValueError:
            raise SolariError(f"--exposure {exposure}: give an EV100 such as 9.5, or auto") from None
    for warning in scene.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    return Subject(scene, cameras, exposure == "auto", played, still)


def _load_scene(job: SceneOptions) -> Scene:
    if job.source.startswith("builtin:"):
        for name in ("scene", "variant", "up", "unit"):
            if (value := getattr(job, name)) is not None:
                raise SolariError(f"--{name} {value}: a built-in scene has none: leave the option out")
        return sv.builtin(job.source.removeprefix("builtin:"))
    scene = job.scene if job.scene is None or (index := _index(job.scene)) is None else index
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", f".*{re.escape(INSTALL)}")  # `load` prints it
        return sv.load(job.source, scene=scene, variant=job.variant, up=job.up, unit=job.unit, strict=job.strict)


def _index(text: str) -> int | None:
    """The number that a text is, None if it is none."""
    return int(text) if text.isdecimal() and len(text) < MAX_DIGITS else None


def _find_clip(scene: Scene, source: str, name: str | None, time: float | None, plays: bool) -> Animation | None:
    """The clip that --clip names, the first if only --time or --animate file need one, None if none does."""
    if name is None and time is None and not plays:
        return None
    if not scene.animations:
        given = "--clip" if name is not None else "--time" if time is not None else "--animate file"
        raise SolariError(f"{given}: {source} has no animations")
    if plays and time is not None:
        raise SolariError(f"--time {time:g}: --animate file plays the whole clip: leave one of the two out")
    if not plays and time is None:
        raise SolariError(f"--clip {name}: give --animate file for a movie of it, or --time for a picture")
    text = name or "0"
    index = None if text in scene.animations else _index(text)
    return scene.animations[text if index is None else index]


def _path(
    movie: MovieJob, scene: Scene, camera: Camera, clip: Animation | None, sweep: tuple[float | None] | None
) -> list[Camera]:
    """The cameras of an animation that starts at `camera`."""
    count = movie.frames or (ORBIT_PICTURES if clip is None else max(round(clip.duration * movie.fps), 1))
    if count > MAX_CAMERAS:
        raise SolariError(f"--frames {count}: an animation has at most {MAX_CAMERAS:,} pictures")
    if clip is not None:
        return [camera] * count
    if sweep is None:
        if movie.animate in scene.animations and not Path(movie.animate).exists():
            raise SolariError(
                f"--animate {movie.animate}: is a clip of the file: give --animate file --clip {quoted(movie.animate)}"
            )
        return load_path(movie.animate, camera, fps=movie.fps, count=movie.frames)
    return orbit(camera, scene.bounds.center, count, *sweep)


def _sweep(movie: MovieJob) -> tuple[float | None] | None:
    """The degrees through which --animate orbit swings, None for all around; None for another animation."""
    kind, colon, sweep = movie.animate.partition(":")
    if kind != "orbit":
        return None
    try:
        degrees = float(sweep) if colon else None
    except ValueError:
        degrees = math.nan
    if degrees is not None and not math.isfinite(degrees):
        raise SolariError(f"--animate {movie.animate}: give an angle such as orbit:30")
    return (degrees,)


def _find_camera(scene: Scene, text: str) -> Camera:
    """The camera that the option --camera names."""
    if (index := _index(text)) is not None:
        if index >= len(scene.cameras):
            raise SolariError(f"--camera {text}: {scene.describe()} has {len(scene.cameras)} cameras, counted from 0")
        return scene.cameras[index]
    if text in scene.cameras:
        return scene.cameras[text]
    where = f"--camera {text}: neither a camera's name, nor a pose, nor a file of one"
    try:
        pose = json.loads(text) if text.lstrip().startswith("{") else read_json(Path(text), where)
    except (ValueError, RecursionError) as error:
        raise SolariError(f"--camera {text}: not a pose as JSON ({error})") from None
    try:
        return Camera.from_pose(pose)
    except SolariError as error:
        raise SolariError(f"--camera {text}: {error}") from None


def open_shutter(job: StillJob | MovieJob, subject: Subject) -> dict[str, Any]:
    """The arguments of `render` for --shutter of a still picture."""
    if job.shutter is None:
        return {}
    clip, opens = subject.still, job.time or 0.0
    if clip is None:
        raise SolariError(
            "--shutter: nothing moves in a still picture: give --time, of the file's animation, or --animate"
        )
    shutter = Shutter(open=opens, close=opens + job.shutter[0], readout=job.shutter[1])
    return {"shutter": shutter, "pose": lambda seconds: clip.apply(subject.scene, seconds, loop=False)}
