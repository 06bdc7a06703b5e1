"""A photo studio for scenes that have no light of their own, such as most glTF files of single objects."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, checked_keywords
from solari_vk.scene import shapes
from solari_vk.scene.builtin import matte
from solari_vk.scene.lights.environment import Environment, directions, solid_angles
from solari_vk.scene.lights.punctual import PointLight
from solari_vk.scene.model import Camera, Scene
from solari_vk.scene.presenting.enclosures import Room

HEIGHT, WIDTH = 256, 512
FLOOR_ALBEDO = 0.18
FLOOR_IN_RADII = 60.0  # of the scene
ZENITH = 0.5  # radiance of the walls overhead over that at the horizon
# Soft boxes: heading from the camera and height of the center, half width and half height, all in degrees, and the
# radiance. The key light stands at the camera's left, the fill light at its right, two strips behind the scene.
BOXES = (
    (-58, 42, 14, 13, 110.0),
    (60, 25, 20, 24, 1.2),
    (155, 35, 8, 30, 12.0),
    (-150, 30, 6, 28, 8.0),
    (0, 85, 20, 20, 1.0),
)
LAMP_INTENSITY = 250.0  # cd
_EDGE = math.radians(5)  # over which a box fades out


def studio_environment(brightness: float = 1.0) -> Environment:
    """Soft boxes before a wall, (HEIGHT, WIDTH) texels, seen from +z; the wall's radiance at the horizon is given.

    Below the horizon the map has the radiance of an endless matte floor of FLOOR_ALBEDO. A real floor of that albedo
    in this light looks the same, and so it shows nothing but shadows.
    """
    toward = directions(HEIGHT, WIDTH)
    up = toward[..., 1]
    boxes = np.zeros((HEIGHT, WIDTH))
    for heading, height, half_width, half_height, radiance in BOXES:
        boxes = np.maximum(boxes, radiance * _box(toward, heading, height, half_width, half_height))
    wall = 1 + (ZENITH - 1) * np.clip(up, 0, 1)
    weights = np.clip(up, 0, None) * solid_angles(HEIGHT, WIDTH) * (FLOOR_ALBEDO / math.pi)
    # The floor has the wall's radiance at the horizon, 1, when the boxes give what the wall itself doesn't.
    boxes *= (1 - (weights * wall).sum()) / (weights * boxes).sum()
    gray = brightness * np.where(up > 0, wall + boxes, 1.0)
    return Environment(gray, name="studio")


def _box(
    toward: NDArray[np.float64], heading: float, height: float, half_width: float, half_height: float
) -> NDArray[np.float64]:
    """How much of a soft box each direction sees, from 0 to 1."""
    angle = math.radians(heading)
    up = math.radians(height)
    center = np.array((math.sin(angle) * math.cos(up), math.sin(up), math.cos(angle) * math.cos(up)))
    side = np.array((math.cos(angle), 0.0, -math.sin(angle)))
    along = toward @ center
    across = np.arctan2(toward @ side, along), np.arctan2(toward @ np.cross(center, side), along)
    # A smoothstep over _EDGE at each side, so that highlights have soft borders.
    seen = np.ones(toward.shape[:2])
    for offset, half in zip(across, (half_width, half_height), strict=True):
        share = np.clip((math.radians(half) - np.abs(offset)) / _EDGE + 0.5, 0, 1)
        seen *= share**2 * (3 - 2 * share)
    return seen


@checked_keywords(who="solari_vk")
def studio_lights(scene: Scene, *, ev100: float = 0.0, ground: bool = True, camera: Camera | None = None) -> Scene:
    """Light a scene as in a photo studio, and return it: its environment is replaced, and it gets a floor.

    The soft boxes stand around the camera's view of the scene; without a camera the front is +z. They are as bright as
    a picture with this ev100 needs. The floor lies under the scene's bounds; it shows shadows, and looks like the
    background elsewhere. Raises SolariError for a scene that is a single point.
    """
    bounds = scene.bounds
    if not bounds.radius > 0:
        raise SolariError(f"{scene.describe()} is a single point: a studio needs geometry with a size")
    scene.environment = environment = studio_environment(FLOOR_ALBEDO * 1.2 * 2.0**ev100)
    environment.rotation = 0.0 if camera is None else heading(camera)
    if ground:
        add_floor(scene, FLOOR_ALBEDO)
    return scene


def add_floor(scene: Scene, albedo: float) -> None:
    """Add a matte round floor just under the scene's bounds, as its backdrop."""
    if scene.backdrop is not None and scene.backdrop in scene.instances:
        scene.remove(scene.backdrop)
    bounds = scene.bounds
    sides = 64
    turns = np.linspace(0, 2 * math.pi, sides, endpoint=False)
    # So large that its edge is at the horizon, and a little below what stands on it, or both would lie in one plane.
    rim = FLOOR_IN_RADII * bounds.radius * np.stack([np.cos(turns), np.zeros(sides), -np.sin(turns)], axis=-1)
    at = np.array((bounds.center[0], bounds.min[1] - 1e-3 * bounds.radius, bounds.center[2]))
    scene.backdrop = scene.add(shapes.polygons(at + rim), matte(albedo, "floor"), name="floor")


def heading(camera: Camera) -> float:
    """The angle about the y axis from +z to the direction from which a camera looks, in radians."""
    x, _, z = camera.transform[:3, 2]
    return math.atan2(x, z)


def add_lamp(scene: Scene, room: Room) -> None:
    """Add a round lamp near the ceiling of a room, as bright as four old light bulbs."""
    position = room.center + np.array((0, 0.8 * room.above, 0))
    radius = 0.04 * (room.above + room.below)
    scene.add(PointLight(position, intensity=LAMP_INTENSITY, radius=radius, name="lamp"))
