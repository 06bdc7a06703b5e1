"""The options that say what surrounds a scene."""

from __future__ import annotations

import argparse
import math
import sys
from typing import Any

import numpy as np

from solari_vk.errors import SolariError
from solari_vk.scene.framing import Room, extent, find_room
from solari_vk.scene.model import Camera, Scene

# In cd/m^2, of emissive surfaces that light a scene: a tenth of the studio's walls. Weaker ones are signs and screens.
LEAST_EMISSION = 0.04
SUN_HEADING, SUN_HEIGHT = math.radians(-50), math.radians(40)  # from the camera's heading, and above the horizon


def add_environment_options(parser: Any) -> None:
    """Add --environment and what changes it."""
    parser.add_argument("--environment", default="auto", metavar="auto|studio|sky|none|FILE",
                        help="what surrounds the scene: soft boxes, a clear sky with its sun, nothing, or a picture of "
                        "all directions (.hdr, .exr, .png, .jpg); auto: the file's own, and studio for files without "
                        "light, or a lamp for closed rooms (auto)")
    parser.add_argument("--environment-rotation", type=_number, default=0.0, metavar="DEGREES",
                        help="turn it about the vertical axis (0)")
    parser.add_argument("--environment-intensity", type=_factor, default=1.0, metavar="FACTOR",
                        help="make it brighter or darker (1)")


def environment_words(options: argparse.Namespace) -> list[str]:
    """The options as words of a command line."""
    return [
        "--environment", options.environment, f"--environment-rotation={options.environment_rotation:g}",
        "--environment-intensity", f"{options.environment_intensity:g}",
    ]  # fmt: skip


def add_environment(scene: Scene, camera: Camera, options: argparse.Namespace) -> bool:
    """Surround a scene by what the options ask for. Returns whether a studio alone lights it, which suits EV100 0.

    camera: the scene's default one, so that --camera doesn't turn the light.
    """
    from solari_vk.scene.emission import mean_emission
    from solari_vk.scene.studio import add_lamp, studio_lights

    lit = any(light.emits for light in scene.lights) or mean_emission(scene) >= LEAST_EMISSION
    kind = options.environment
    if kind == "auto" and not lit:
        room = _room(scene)
        kind, place = ("studio", "shown in a studio") if room is None else ("auto", "a room, and gets a lamp")
        print(f"{options.source} has no light of its own: it is {place}", file=sys.stderr)
        if room is not None:
            add_lamp(scene, room)
    if kind == "none":
        scene.environment = None
    elif kind == "studio":
        studio_lights(scene, camera=camera, ground=not lit)
    elif kind == "sky":
        _add_sky(scene, camera, lit)
    elif kind != "auto":
        from solari_vk.scene.lights.environment import Environment

        scene.environment = Environment(kind)
    _adjust(scene, math.radians(options.environment_rotation), options.environment_intensity)
    return kind == "studio" and not lit


def _room(scene: Scene) -> Room | None:
    visible = [instance for instance in scene if instance.visible]
    return find_room(visible, extent(visible)) if visible else None


def _add_sky(scene: Scene, camera: Camera, lit: bool) -> None:
    """A sky whose sun stands behind the camera's left shoulder, over a floor if the scene has no light of its own."""
    from solari_vk.scene.lights.sky import Sky
    from solari_vk.scene.studio import add_floor, heading

    turn, across = heading(camera) + SUN_HEADING, math.cos(SUN_HEIGHT)
    sky = Sky(np.array((across * math.sin(turn), math.sin(SUN_HEIGHT), across * math.cos(turn)), np.float32))
    if not lit:
        add_floor(scene, float(sky.ground_albedo.mean()))
    scene.environment = sky


def _adjust(scene: Scene, angle: float, intensity: float) -> None:
    """Turn the environment about the y axis by an angle in radians, and multiply its intensity."""
    if angle == 0 and intensity == 1:
        return
    environment = scene.environment
    if environment is None:
        raise SolariError("--environment-rotation and -intensity: there is no environment: give one by --environment")
    environment.turn(angle)
    environment.intensity *= intensity


def _number(text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number")
    return number


def _factor(text: str) -> float:
    number = _number(text)
    if number < 0:
        raise argparse.ArgumentTypeError(f"must not be negative, as {text} is")
    return number
