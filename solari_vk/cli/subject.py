"""What a command renders: the scene, the cameras and the exposure, from the command's options."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import solari_vk as sv
from solari_vk.cli.environment import add_environment
from solari_vk.errors import SolariError
from solari_vk.output.animation import load_path, orbit
from solari_vk.scene.model import Animation, Camera, Scene

ORBIT_PICTURES = 48


def names_of_aovs(options: argparse.Namespace) -> list[str]:
    """The names in --aov."""
    return [name.strip() for name in options.aov.split(",") if name.strip()]


def check_aovs(names: Sequence[str], mode: str, known: Sequence[str]) -> None:
    """Raise SolariError for a name that isn't among the outputs of a mode."""
    for name in names:
        if name not in known:
            raise SolariError(f"--aov {name}: --mode {mode} has no such output; it has {', '.join(known)}")


@dataclass
class Subject:
    """A scene, and how to look at it."""

    scene: Scene
    cameras: list[Camera]
    """One camera, or those of an animation."""
    auto_exposure: bool
    """Whether the picture chooses the exposure, not the cameras."""
    clip: Animation | None = None
    """What --animate file plays."""


def load(options: argparse.Namespace) -> Subject:
    """The scene, the cameras and the exposure that the options ask for."""
    builtin = options.source.startswith("builtin:")
    if builtin:
        for name in ("scene", "variant", "up", "unit"):
            if getattr(options, name) is not None:
                raise SolariError(f"--{name} {getattr(options, name)}: a built-in scene has none: leave the option out")
        scene = sv.builtin(options.source.removeprefix("builtin:"))
    else:
        which = options.scene
        scene = sv.load(
            options.source, scene=int(which) if which and which.isdecimal() else which, variant=options.variant,
            up=options.up, unit=options.unit, strict=options.strict,
        )  # fmt: skip
    clip = _find_clip(options, scene)
    if clip is not None and options.time is not None:
        clip.apply(scene, options.time, loop=False)
    played = clip if options.animate == "file" else None
    front = scene.camera_for(options.size[0] / options.size[1], played)
    camera = front if options.camera is None else _find_camera(scene, options.camera)
    cameras = [camera] if options.animate is None else _path(options, scene, camera, clip)
    in_studio = add_environment(scene, front, options)
    exposure = options.exposure or ("camera" if builtin or in_studio else "auto")
    if exposure not in ("auto", "camera"):
        try:
            for camera in cameras:
                camera.ev100 = float(exposure)
        except ValueError:
            raise SolariError(f"--exposure {exposure}: give an EV100 such as 9.5, or auto") from None
    for warning in scene.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    return Subject(scene, cameras, exposure == "auto", played)


def _find_clip(options: argparse.Namespace, scene: Scene) -> Animation | None:
    """The clip that the options name, the first if they only need one. Raises SolariError for an unknown one."""
    if options.clip is None and options.time is None and options.animate != "file":
        return None
    if not scene.animations:
        name = "--clip" if options.clip is not None else "--time" if options.time is not None else "--animate file"
        raise SolariError(f"{name}: {options.source} has no animations")
    if options.animate == "file" and options.time is not None:
        raise SolariError(f"--time {options.time:g}: --animate file plays the whole clip: leave one of the two out")
    if options.animate != "file" and options.time is None:
        raise SolariError(f"--clip {options.clip}: give --animate file for a movie of it, or --time for a picture")
    text = options.clip or "0"
    if text.isdecimal() and text not in scene.animations:
        return scene.animations[int(text)]
    return scene.animations[text]


def _path(options: argparse.Namespace, scene: Scene, camera: Camera, clip: Animation | None) -> list[Camera]:
    """The cameras of an animation that starts at `camera`. Call it before added lights widen the scene's bounds."""
    if options.animate == "file" and clip is not None:
        return [camera] * (options.frames or max(round(clip.duration * options.fps), 1))
    kind, colon, sweep = options.animate.partition(":")
    if kind != "orbit":
        return load_path(options.animate, camera, fps=options.fps, count=options.frames)
    try:
        degrees = float(sweep) if colon else None
    except ValueError:
        degrees = math.nan
    if degrees is not None and not math.isfinite(degrees):
        raise SolariError(f"--animate {options.animate}: give an angle such as orbit:30")
    return orbit(camera, scene.bounds.center, options.frames or ORBIT_PICTURES, degrees)


def _find_camera(scene: Scene, text: str) -> Camera:
    """The camera that the option --camera names."""
    if text.isdecimal():
        if int(text) >= len(scene.cameras):
            raise SolariError(f"--camera {text}: {scene.describe()} has {len(scene.cameras)} cameras, counted from 0")
        return scene.cameras[int(text)]
    if text in scene.cameras:
        return scene.cameras[text]
    try:
        pose = json.loads(text if text.lstrip().startswith("{") else Path(text).read_text())
    except (OSError, ValueError, RecursionError) as error:
        raise SolariError(f"--camera {text}: not a camera's name, a pose as JSON or a file of one ({error})") from None
    try:
        return Camera.from_pose(pose)
    except SolariError as error:
        raise SolariError(f"--camera {text}: {error}") from None
