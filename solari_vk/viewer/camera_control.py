"""How a user moves a camera: flying, looking around, orbiting around a point, focusing on it. Needs no window."""

from __future__ import annotations

import dataclasses
import json
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.errors import SolariError
from solari_vk.scene.matrices import nearest_rotation, rotation, turned_about
from solari_vk.scene.model import Camera

UP = np.array((0.0, 1.0, 0.0))
TURN = 0.005  # radians per unit of cursor movement
MAX_ELEVATION = math.radians(89)  # largest angle between the view direction and the horizon
FASTER = 4.0  # factor of the speed while shift is held
WHEEL = 1.25  # factor of the speed for each notch of the wheel
# Directions in camera space, and in world space.
DIRECTIONS = {"forward": (0, 0, -1), "back": (0, 0, 1), "left": (-1, 0, 0), "right": (1, 0, 0)}
WORLD_DIRECTIONS = {"up": (0, 1, 0), "down": (0, -1, 0)}


class CameraControl:
    """Moves `camera`, a copy of the given one. `speed`, in meters per second, starts at a quarter of the extent.

    extent: the size of the scene, in meters.
    """

    def __init__(self, camera: Camera, extent: float = 1.0) -> None:
        self.home, self.camera = dataclasses.replace(camera), dataclasses.replace(camera)
        self.home_speed = self.speed = max(extent, 1e-6) / 4
        self.held: set[str] = set()
        """The names of the directions whose keys are down."""
        self.fast = False

    def advance(self, seconds: float) -> None:
        """Fly in the directions that are held, for this many seconds."""
        turn, direction = self.camera.transform[:3, :3], np.zeros(3)
        for name in self.held:
            direction += WORLD_DIRECTIONS[name] if name in WORLD_DIRECTIONS else turn @ DIRECTIONS[name]
        length = float(np.linalg.norm(direction))
        if length > 1e-9:
            distance = self.speed * (FASTER if self.fast else 1.0) * seconds
            transform = self.camera.transform.copy()
            transform[:3, 3] += direction * (distance / length)
            self._assign(transform)

    def change_speed(self, notches: float) -> None:
        """Change the speed by notches of the wheel; a positive number is faster."""
        factor = WHEEL ** min(max(notches, -20.0), 20.0)
        self.speed = min(max(self.speed * factor, 1e-3 * self.home_speed), 1e3 * self.home_speed)

    def look(self, right: float, down: float) -> None:
        """Turn the camera about its own position by a movement of the cursor."""
        self._turn(right, down, self.camera.transform[:3, 3])

    def orbit(self, right: float, down: float, center: ArrayLike) -> None:
        """Turn the camera around a point in world space by a movement of the cursor."""
        self._turn(right, down, center)

    def focus(self, point: ArrayLike, radius: float) -> None:
        """Look at a point, keeping the view direction, from where the whole sphere of `radius` around it is visible."""
        distance = max(radius, 1e-6) / math.sin(self.camera.vertical_fov / 2)
        transform = self.camera.transform.copy()
        transform[:3, 3] = np.asarray(point, np.float64) + distance * transform[:3, 2]
        self._assign(transform)

    def expose(self, stops: float) -> None:
        """Make the picture brighter by this many stops."""
        self.camera.ev100 = min(max(self.camera.ev100 - stops, -100.0), 100.0)

    def take(self, camera: Camera) -> None:
        """Take another camera's pose and field of view, and keep the exposure."""
        self.camera.update(transform=camera.transform, vertical_fov=camera.vertical_fov, near=camera.near)

    def reset(self) -> None:
        """Return to the first pose and speed."""
        self.camera = dataclasses.replace(self.home)
        self.speed = self.home_speed

    def copy_pose(self) -> str:
        """The camera as JSON that `paste_pose` and `solari-vk render --camera` take."""
        return json.dumps(self.camera.pose())

    def paste_pose(self, text: str) -> None:
        """Take the pose in a text from `copy_pose`. Raises SolariError for any other text."""
        try:
            pose: Any = json.loads(text)
        except ValueError:
            raise SolariError(f"the clipboard holds no camera pose, but {text[:40]!r}") from None
        pasted = Camera.from_pose(pose)
        self.camera.update(transform=pasted.transform, vertical_fov=pasted.vertical_fov)
        if "ev100" in pose:
            self.camera.ev100 = pasted.ev100

    def _turn(self, right: float, down: float, center: ArrayLike) -> None:
        transform = self.camera.transform
        elevation = math.asin(float(np.clip(-transform[1, 2], -1, 1)))  # the view direction's elevation
        limit = max(MAX_ELEVATION, abs(elevation))
        raised = min(max(elevation - TURN * down, -limit), limit) - elevation
        turn = rotation(UP, -TURN * right) @ rotation(transform[:3, 0], raised)
        transform = turned_about(center, turn, transform)
        lengths = np.linalg.norm(transform[:3, :3], axis=0)
        transform[:3, :3] = nearest_rotation(transform[:3, :3] / lengths) * lengths  # rounding errors must not add up
        self._assign(transform)

    def _assign(self, transform: NDArray[np.float64]) -> None:
        # A camera that flies for hours must not reach infinity; there is nothing to see that far away.
        limit = 1e6 * max(self.home_speed, 1.0)
        transform[:3, 3] = np.clip(transform[:3, 3], -limit, limit)
        self.camera.transform = transform
