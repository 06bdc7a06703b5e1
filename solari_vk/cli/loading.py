"""Loads what a command renders: the scene, the cameras and the exposure."""

from __future__ import annotations

import json
import math
import re
import sys
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import solari_vk as sv
from solari_vk.base.errors import SolariError, advice_for, quoted
from solari_vk.base.files import read_json
from solari_vk.cli.jobs import ORBIT_SECONDS, MovieJob, SceneOptions, StillJob
from solari_vk.output.animation import MAX_CAMERAS, load_path, orbit, orbit_turns
from solari_vk.scene.files.libraries import INSTALL
from solari_vk.scene.lights.sky import Sky
from solari_vk.scene.model import Animation, Camera, Scene
from solari_vk.scene.presenting.surroundings import surround
from solari_vk.scene.shutter import Shutter

BUILTIN = "builtin:"
ORBIT_PLACES = 48  # from which an orbit's camera must see the scene whole
MAX_DIGITS = 10  # of an index: Python refuses to read numbers with thousands


@dataclass
class LoadedScene:
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
    sun_times: list[datetime] = field(default_factory=list)
    """Of the pictures of --animate sun."""

    def pose(self, picture: int, fps: int) -> None:
        """Pose the scene as a picture of an animation shows it."""
        if self.clip is not None:
            self.clip.apply(self.scene, picture / fps)
        if self.sun_times:
            environment: Any = self.scene.environment
            environment.time = self.sun_times[picture]


@dataclass(frozen=True)
class _Orbit:
    """A path of the camera around the scene."""

    swing: float | None
    """The angle in degrees through which it swings and back; None once around."""


def load_scene(
    job: SceneOptions, *, clip: str | None = None, time: float | None = None, seen_all_round: bool = False
) -> LoadedScene:
    """The scene, the cameras and the exposure of a job; a still one is posed as it is at a time in a clip.

    seen_all_round: cameras will go around the scene, so that what frames it must do so from all sides.
    """
    movie = job if isinstance(job, MovieJob) else None
    scene = _read_scene(job)
    chosen = _find_clip(scene, job.source, clip, time, plays=movie is not None and movie.animate == "file")
    # The pose comes before the cameras, which frame what is in the picture.
    played, still = _pose(scene, chosen, time)
    path = _orbit_of(job)
    front = _front_camera(scene, job, played, _Orbit(None) if seen_all_round else path)
    # The one in front frames the scene; one that --camera names stays where it is.
    camera = front if job.camera is None else _find_camera(scene, job.camera)
    # Before lights are added: they widen the scene's bounds, around whose center an orbit goes.
    cameras = [camera] if movie is None else _animated_cameras(movie, scene, camera, played, path)
    # By the camera in front, so that --camera doesn't turn the light.
    light_added, lit_by_studio = surround(scene, front, "sky" if job.sun else job.environment)
    times = _place_sun(job, scene, len(cameras))
    _hide_backdrop(job, scene, cameras)
    if light_added:
        print(f"{job.source} has no light of its own: it is {light_added}", file=sys.stderr)
    _adjust_environment(job, scene)
    auto_exposure = _expose(cameras, job.exposure or _default_exposure(job, cameras[0], lit_by_studio))
    for warning in scene.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    return LoadedScene(scene, cameras, auto_exposure, played, still, times)


def set_exposure(cameras: Iterable[Camera], ev100: float) -> None:
    """Give cameras one exposure."""
    for camera in cameras:
        camera.ev100 = ev100


def check_aovs(names: Sequence[str], mode: str, known: Sequence[str]) -> None:
    """Raise SolariError for a name that isn't among the outputs of a mode."""
    for name in names:
        if name not in known:
            there = advice_for("--aov", name) or f"it has {', '.join(known)}"
            raise SolariError(f"--aov {name}: --mode {mode} has no such output; {there}")


def shutter_arguments(job: StillJob | MovieJob, loaded: LoadedScene) -> dict[str, Any]:
    """The arguments of `render` for --shutter of a still picture."""
    if job.shutter is None:
        return {}
    clip = loaded.still
    if clip is None:
        raise SolariError(
            "--shutter: nothing moves in a still picture: give --time, of the file's animation, or --animate"
        )
    seconds, readout = job.shutter
    opens = job.time or 0.0
    return {
        "shutter": Shutter(open=opens, close=opens + seconds, readout=readout),
        "pose": lambda time: clip.apply(loaded.scene, time, loop=False),
    }


# ---- the scene --------------------------------------------------------------------------------------


def _read_scene(job: SceneOptions) -> Scene:
    if job.source.startswith(BUILTIN):
        for name in ("scene", "variant", "up", "unit"):
            value = getattr(job, name)
            if value is not None:
                raise SolariError(f"--{name} {value}: a built-in scene has none: leave the option out")
        return sv.builtin(job.source.removeprefix(BUILTIN))
    with warnings.catch_warnings():
        # Libraries that are missing are among the scene's own warnings too, which `load_scene` prints.
        warnings.filterwarnings("ignore", f".*{re.escape(INSTALL)}")
        scene = None if job.scene is None else _name_or_index(job.scene)
        return sv.load(job.source, scene=scene, variant=job.variant, up=job.up, unit=job.unit, strict=job.strict)


def _name_or_index(text: str) -> str | int:
    return int(text) if text.isdecimal() and len(text) < MAX_DIGITS else text


def _hide_backdrop(job: SceneOptions, scene: Scene, cameras: Iterable[Camera]) -> None:
    """Leave out a studio's floor if --transparent asks for it."""
    if not getattr(job, "transparent", False):
        return
    if any(camera.aperture for camera in cameras):
        raise SolariError(
            "--transparent: the camera has an aperture, whose blurred edges have no alpha: give --camera without one"
        )
    if scene.backdrop is not None:
        scene.backdrop.visible = False


def _place_sun(job: SceneOptions, scene: Scene, count: int) -> list[datetime]:
    """Give the sky the sun of --place and --sun; returns the times of the pictures of --animate sun."""
    moves = isinstance(job, MovieJob) and job.animate == "sun"
    if job.sun is None and job.place is None and not moves:
        return []
    if job.sun is None or job.place is None:
        raise SolariError("--sun and --place go together: --place 52.5,13.4 --sun 2026-06-21T15:00+02:00")
    if job.environment not in ("auto", "sky"):
        raise SolariError(f"--sun: it is in a sky, not in --environment {job.environment}: leave one of the two out")
    texts = job.sun.split("/")
    if len(texts) != (2 if moves else 1):
        raise SolariError(
            f"--sun {job.sun}: a still picture has one time, --animate sun two, such as "
            "2026-06-21T06:00+02:00/2026-06-21T20:00+02:00"
        )
    times: list[Any] = []
    sky = Sky()
    for text in reversed(texts):
        sky.update(place=job.place, time=text)
        times.insert(0, sky.time)
    scene.environment = sky
    first, last = times[0], times[-1]
    return [first + (last - first) * (index / max(count - 1, 1)) for index in range(count)] if moves else []


def _adjust_environment(job: SceneOptions, scene: Scene) -> None:
    """Turn the environment, and make it brighter or darker, as options say."""
    if not job.environment_rotation and job.environment_intensity == 1:
        return
    if scene.environment is None:
        raise SolariError("--environment-rotation and -intensity: there is no environment: give one by --environment")
    scene.environment.turn(math.radians(job.environment_rotation))
    scene.environment.intensity *= job.environment_intensity


# ---- its animation ----------------------------------------------------------------------------------


def _find_clip(scene: Scene, source: str, name: str | None, time: float | None, plays: bool) -> Animation | None:
    """The clip that --clip names, the first if only --time or --animate file need one, None if none does."""
    option = _option_with_clip(name, time, plays)
    if not option:
        return None
    if not scene.animations:
        raise SolariError(f"{option}: {source} has no animations")
    if plays and time is not None:
        raise SolariError(f"--time {time:g}: --animate file plays the whole clip: leave one of the two out")
    if not plays and time is None:
        raise SolariError(f"--clip {name}: give --animate file for a movie of it, or --time for a picture")
    text = name or "0"
    # A clip may have a number for its name.
    return scene.animations[text if text in scene.animations else _name_or_index(text)]


def _pose(scene: Scene, clip: Animation | None, time: float | None) -> tuple[Animation | None, Animation | None]:
    """Pose a scene as it is at a time in a clip, if there is one. Returns the clip that plays, and that of a pose."""
    if clip is None or time is None:
        return clip, None
    clip.apply(scene, time, loop=False)
    return None, clip


def _option_with_clip(name: str | None, time: float | None, plays: bool) -> str:
    """The first option that needs a clip, "" if none does."""
    if name is not None:
        return "--clip"
    if time is not None:
        return "--time"
    return "--animate file" if plays else ""


# ---- cameras ----------------------------------------------------------------------------------------


def _orbit_of(job: SceneOptions) -> _Orbit | None:
    """What --animate orbit[:DEGREES] asks for, None for another animation and for none."""
    if not isinstance(job, MovieJob):
        return None
    kind, colon, angle = job.animate.partition(":")
    if kind != "orbit":
        return None
    if not colon:
        return _Orbit(None)
    try:
        degrees = float(angle)
    except ValueError:
        degrees = math.nan
    if not math.isfinite(degrees):
        raise SolariError(f"--animate {job.animate}: give an angle such as orbit:30")
    return _Orbit(degrees)


def _front_camera(scene: Scene, job: SceneOptions, clip: Animation | None, path: _Orbit | None) -> Camera:
    """The scene's camera, or one that frames the scene in all poses of a clip and from all places of an orbit."""
    turns = [0.0] if path is None else orbit_turns(ORBIT_PLACES, path.swing).tolist()
    width, height = job.size
    return scene.camera_for(width / height, clip, turns=turns)


def _find_camera(scene: Scene, text: str) -> Camera:
    """The camera that the option --camera names."""
    index = _name_or_index(text)
    if isinstance(index, int):
        if index >= len(scene.cameras):
            raise SolariError(f"--camera {text}: {scene.describe()} has {len(scene.cameras)} cameras, counted from 0")
        return scene.cameras[index]
    if text in scene.cameras:
        return scene.cameras[text]
    try:
        return Camera.from_pose(_read_pose(text))
    except SolariError as error:
        raise SolariError(f"--camera {text}: {error}") from None


def _read_pose(text: str) -> Any:
    """A pose as JSON, or in a file."""
    if not text.lstrip().startswith("{"):
        return read_json(Path(text), "neither a camera's name, nor a pose, nor a file of one")
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise SolariError(f"not a pose as JSON ({error})") from None


def _animated_cameras(
    movie: MovieJob, scene: Scene, camera: Camera, clip: Animation | None, path: _Orbit | None
) -> list[Camera]:
    """The cameras of an animation that starts at `camera`."""
    lasts = movie.duration
    if lasts is not None and not 0 < lasts < math.inf:
        raise SolariError(f"--duration {lasts:g}: give a number of seconds above 0")
    own = ORBIT_SECONDS if clip is None else clip.duration
    count = movie.frames or max(round((lasts or own) * movie.fps), 1)
    if count > MAX_CAMERAS:
        option = f"--frames {count}" if movie.frames else f"--fps {movie.fps} for {lasts or own:g} s"
        raise SolariError(f"{option}: an animation has at most {MAX_CAMERAS:,} pictures")
    if clip is not None:
        return [camera] * count  # the scene moves, the camera rests
    if movie.animate == "sun":
        return [camera] * count
    if path is not None:
        return orbit(camera, scene.bounds.center, count, path.swing)
    if movie.animate in scene.animations and not Path(movie.animate).exists():
        raise SolariError(
            f"--animate {movie.animate}: is a clip of the file: give --animate file --clip {quoted(movie.animate)}"
        )
    given = movie.frames or (None if lasts is None else count)
    return load_path(movie.animate, camera, fps=movie.fps, count=given)


def _default_exposure(job: SceneOptions, camera: Camera, lit_by_studio: bool) -> str:
    # The light of built-in scenes and of the studio is made for the exposure that their cameras have.
    if job.sun:
        return "auto"
    if job.source.startswith(BUILTIN) or lit_by_studio:
        return "camera"
    return "camera" if camera.has_exposure and not camera.auto_exposure else "auto"


def _expose(cameras: Sequence[Camera], exposure: str) -> bool:
    """Expose cameras as by the option --exposure; whether the picture decides instead."""
    if exposure in ("auto", "each"):
        return True
    if exposure == "camera":
        for camera in cameras:
            # Assigned, it counts as an exposure that somebody chose, which no meter changes.
            camera.ev100 = float(camera.ev100)
        return False
    try:
        set_exposure(cameras, float(exposure))
    except ValueError:
        raise SolariError(f"--exposure {exposure}: give an EV100 such as 9.5, auto or each") from None
    return False
