"""How a user moves a camera: flying, looking around, orbiting around a point, focusing on it. Needs no window."""

from __future__ import annotations

import dataclasses
import json
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.base.errors import SolariError
from solari_vk.scene.calibrated import LENS_FIELDS
from solari_vk.scene.matrices import nearest_rotation, rotation, turned_about
from solari_vk.scene.model import Camera, Scene

UP = np.array((0.0, 1.0, 0.0))
TURN = 0.005  # radians per unit of cursor movement
MAX_ELEVATION = math.radians(89)  # largest angle between the view direction and the horizon
FASTER = 4.0  # factor of the speed while shift is held
WHEEL = 1.25  # factor of the pace for each notch of the wheel
PACE = 0.5  # share of the distance to what is seen that is flown in a second
SMOOTHING = 0.08  # seconds in which the velocity comes within 37 % of what the keys ask for
WIDEST = 2.5  # radians: pans of wider lenses are those of this field of view
STEP = 0.01  # seconds of a step of the movement, so that it doesn't depend on the frame rate
# Directions in camera space, and in world space.
DIRECTIONS = {"forward": (0, 0, -1), "back": (0, 0, 1), "left": (-1, 0, 0), "right": (1, 0, 0)}
WORLD_DIRECTIONS = {"up": (0, 1, 0), "down": (0, -1, 0)}


class CameraControl:
    """Moves `camera`, a copy of the given one.

    extent: the size of the scene, in meters. The speed is `pace` times `distance`, so a camera that flies to a surface
    slows down before it, and in large and small scenes steps are as large on the screen.
    """

    def __init__(self, camera: Camera, extent: float = 1.0) -> None:
        self.begin(camera, extent)

    def begin(self, camera: Camera, extent: float) -> None:
        """Start anew, as with another scene."""
        self.home = dataclasses.replace(camera)
        self.camera = dataclasses.replace(camera)
        self.pace = PACE
        self.pressed: set[str] = set()
        """The names of the directions whose keys are down."""
        self.fast = False
        self._nearest = 1e-3 * max(extent, 1e-6)
        self._farthest = 1e6 * max(extent, 1.0)
        self.distance = self._home_distance = max(extent, 1e-6) / 3
        """Meters from the camera to what is seen in the middle of the picture."""
        self._has_seen = False
        self._velocity = np.zeros(3)

    @property
    def speed(self) -> float:
        """Meters per second, without shift."""
        return self.pace * self.distance

    @property
    def flies(self) -> bool:
        """Whether the camera moves by itself, or a key asks for it."""
        return bool(self.pressed) or bool(self._velocity.any())

    @property
    def center(self) -> NDArray[np.float64]:
        """The point in world space that is seen in the middle of the picture, (3,)."""
        return _ahead(self.camera, self.distance)

    @property
    def _home_point(self) -> NDArray[np.float64]:
        return _ahead(self.home, self._home_distance)

    def see(self, distance: float | None) -> None:
        """Set the distance to what is seen, in meters. None, the background: the first view's point counts instead.

        The first call is about the first view.
        """
        if distance is None:
            distance = float(np.linalg.norm(self.camera.transform[:3, 3] - self._home_point))
        self.distance = min(max(distance, self._nearest), self._farthest)
        if not self._has_seen:
            self._has_seen = True
            self._home_distance = self.distance

    def see_point(self, point: ArrayLike) -> None:
        """Set the distance of what is seen: as far away along the view axis as a point (3,) in world space."""
        back = self.camera.transform[:3, 2] / np.linalg.norm(self.camera.transform[:3, 2])
        depth = float((self.camera.transform[:3, 3] - np.asarray(point, np.float64)) @ back)
        if depth > 0:
            self.see(depth)

    def advance(self, seconds: float) -> None:
        """Fly in the directions whose keys are down, for this many seconds. The velocity changes smoothly."""
        position = self.camera.transform[:3, 3].copy()
        # A frame that took seconds must not take a hundred thousand steps.
        steps = min(math.ceil(seconds / STEP), 100) if self.flies else 0
        for _ in range(steps):
            position += self._step(seconds / steps)
        if steps:
            transform = self.camera.transform.copy()
            transform[:3, 3] = position
            self._assign(transform)

    def _step(self, seconds: float) -> NDArray[np.float64]:
        """Change the velocity; returns the path of this many seconds in meters, (3,)."""
        turn = self.camera.transform[:3, :3]
        direction = np.zeros(3)
        for name in self.pressed:
            direction += WORLD_DIRECTIONS[name] if name in WORLD_DIRECTIONS else turn @ DIRECTIONS[name]
        length = float(np.linalg.norm(direction))
        speed = self.speed * (FASTER if self.fast else 1.0)
        wanted = direction * (speed / length) if length > 1e-9 else np.zeros(3)
        # The velocity approaches the wanted one exponentially: v' = (wanted - v) / SMOOTHING. This is the solution and
        # its integral, so that the path doesn't depend on the length of the steps.
        decay = math.exp(-seconds / SMOOTHING)
        path = wanted * seconds + (self._velocity - wanted) * (SMOOTHING * (1 - decay))
        self._velocity = wanted + (self._velocity - wanted) * decay
        if not wanted.any() and np.linalg.norm(self._velocity) < 1e-3 * speed:
            self._velocity = np.zeros(3)
        forward = -float(path @ turn[:, 2] / np.linalg.norm(turn[:, 2]))
        self.distance = min(max(self.distance - forward, self._nearest), self._farthest)
        return path

    def change_speed(self, notches: float) -> None:
        """Change the pace by notches of the wheel; a positive number is faster."""
        factor = WHEEL ** min(max(notches, -20.0), 20.0)
        self.pace = min(max(self.pace * factor, 1e-2 * PACE), 1e2 * PACE)

    def look(self, right: float, down: float) -> None:
        """Turn the camera about its own position by a movement of the cursor."""
        self._turn(right, down, self.camera.transform[:3, 3])

    def orbit(self, right: float, down: float, center: ArrayLike) -> None:
        """Turn the camera around a point in world space by a movement of the cursor."""
        self._turn(right, down, center)

    def zoom(self, notches: float, at: tuple[float, float] = (0.0, 0.0)) -> None:
        """Come nearer to what is seen by notches of the wheel; a negative number goes away from it.

        at: where the cursor is, right of the picture's middle and below it, in shares of the picture's height. What is
        there at `distance` stays there.
        """
        wanted = self.distance * WHEEL ** -min(max(notches, -20.0), 20.0)
        distance = min(max(wanted, self._nearest), self._farthest)
        # Equal steps of the wheel multiply the distance, so that zooming is as quick near and far away. Then the camera
        # moves across by what the point under the cursor moved in the picture.
        anchor = self._seen_across(at)
        center = self.center
        if self.camera.orthographic_height:
            self.camera.orthographic_height *= distance / self.distance
        self._look_from(center, distance)
        transform = self.camera.transform.copy()
        transform[:3, 3] += anchor - self._seen_across(at)
        self._assign(transform)

    def dolly(self, notches: float) -> None:
        """Fly along the view axis by notches of the wheel, past what is seen; a negative number flies back."""
        back = self.camera.transform[:3, 2]
        step = (1 - 1 / WHEEL) * self.distance * min(max(notches, -20.0), 20.0)
        transform = self.camera.transform.copy()
        transform[:3, 3] -= step * back / np.linalg.norm(back)
        self._assign(transform)

    @property
    def seen_height(self) -> float:
        """The height in meters of what the picture shows at `distance`."""
        opening = math.tan(min(self.camera.vertical_fov, WIDEST) / 2)
        return self.camera.orthographic_height or 2 * self.distance * opening

    def _seen_across(self, at: tuple[float, float]) -> NDArray[np.float64]:
        """From the middle of what is seen to what is `at` shares of the picture's height right of it and below."""
        x, y = (axis / np.linalg.norm(axis) for axis in self.camera.transform[:3, :2].T)
        across: NDArray[np.float64] = self.seen_height * (at[0] * x - at[1] * y)
        return across

    def pan(self, right: float, down: float) -> None:
        """Move the camera across its view, so that what is seen at `distance` follows the cursor, which moved by these
        shares of the picture's height."""
        transform = self.camera.transform.copy()
        transform[:3, 3] -= self._seen_across((right, down))
        self._assign(transform)

    def focus(self, point: ArrayLike, radius: float, aspect: float = 1.0) -> None:
        """Look at a point, keeping the view direction, from where the whole sphere of `radius` around it is visible.

        aspect: width / height of the picture.
        """
        radius = max(radius, 1e-6)
        narrow = min(aspect, 1.0)
        if self.camera.orthographic_height:
            self.camera.orthographic_height = 2 * radius / narrow
        # A sphere fills a cone, so its distance follows from the sine of half the narrower field of view.
        half = math.atan(math.tan(min(self.camera.vertical_fov, WIDEST) / 2) * narrow)
        self._look_from(point, radius / math.sin(half))

    def look_along(self, direction: ArrayLike, up: ArrayLike) -> None:
        """Look in a direction at what is seen in the middle, from as far away; up: what points up in the picture."""
        center = self.center
        y, z = np.asarray(up, np.float64), -np.asarray(direction, np.float64)
        turn = np.stack([np.cross(y, z), y, z], axis=1)
        transform = self.camera.transform.copy()
        # A camera's axes may have other lengths than 1.
        transform[:3, :3] = turn * np.linalg.norm(transform[:3, :3], axis=0)
        self._jump(transform)
        self._look_from(center, self.distance)

    def toggle_orthographic(self) -> bool:
        """Switch between an orthographic and a perspective view that shows as much in its middle; returns whether it is
        orthographic now. Raises SolariError for a camera with a lens."""
        center = self.center
        height = self.seen_height
        if not self.camera.orthographic_height:
            self.camera.update(orthographic_height=height)
            return True
        self.camera.update(orthographic_height=0.0)
        self._look_from(center, height / (2 * math.tan(min(self.camera.vertical_fov, WIDEST) / 2)))
        return False

    def focus_home(self) -> None:
        """Look at what the first view showed in its middle, from as far away, keeping the view direction."""
        self._look_from(self._home_point, self._home_distance)

    def _look_from(self, point: ArrayLike, distance: float) -> None:
        transform = self.camera.transform.copy()
        back = transform[:3, 2] / np.linalg.norm(transform[:3, 2])
        transform[:3, 3] = np.asarray(point, np.float64) + distance * back
        self._jump(transform)
        self.see(distance)

    def expose(self, stops: float) -> None:
        """Make the picture brighter by this many stops."""
        self.camera.ev100 = min(max(self.camera.ev100 - stops, -100.0), 100.0)

    def look_through(self, camera: Camera) -> None:
        """Take another camera's pose and field of view, and keep the exposure."""
        self.camera.update(near=camera.near, **_view(camera))
        self._jump(camera.transform)

    def reset(self) -> None:
        """Return to the first pose and pace."""
        self.camera = dataclasses.replace(self.home)
        self.pace = PACE
        self.distance = self._home_distance
        self._velocity = np.zeros(3)

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
        self.camera.update(**_view(pasted))
        self._jump(pasted.transform)
        if "ev100" in pose:
            self.camera.ev100 = pasted.ev100

    def _turn(self, right: float, down: float, center: ArrayLike) -> None:
        transform = self.camera.transform
        elevation = math.asin(float(np.clip(-transform[1, 2], -1, 1)))  # the view direction's elevation
        # Straight up and down the horizon would turn over. A camera that begins beyond the limit may stay there.
        limit = max(MAX_ELEVATION, abs(elevation))
        raised = min(max(elevation - TURN * down, -limit), limit) - elevation
        turn = rotation(UP, -TURN * right) @ rotation(transform[:3, 0], raised)
        transform = turned_about(center, turn, transform)
        lengths = np.linalg.norm(transform[:3, :3], axis=0)
        transform[:3, :3] = nearest_rotation(transform[:3, :3] / lengths) * lengths  # rounding errors must not add up
        self._assign(transform)

    def _jump(self, transform: NDArray[np.float64]) -> None:
        self._velocity = np.zeros(3)
        self._assign(transform.copy())

    def _assign(self, transform: NDArray[np.float64]) -> None:
        # A camera that flies for hours must not reach infinity; there is nothing to see that far away.
        transform[:3, 3] = np.clip(transform[:3, 3], -self._farthest, self._farthest)
        self.camera.transform = transform


def _ahead(camera: Camera, distance: float) -> NDArray[np.float64]:
    """The point in world space that is this far along the view axis, (3,)."""
    back = camera.transform[:3, 2]
    point: NDArray[np.float64] = camera.transform[:3, 3] - distance * back / np.linalg.norm(back)
    return point


def extent_of(scene: Scene) -> float:
    """The length of the diagonal of the scene's bounds, 1 for a scene without bounds."""
    try:
        return float(np.linalg.norm(np.ptp(scene.bounds, axis=0))) or 1.0
    except SolariError:
        return 1.0


def _view(camera: Camera) -> dict[str, Any]:
    """What a camera sees of the world, but for its place."""
    return {name: getattr(camera, name) for name in ("vertical_fov", "orthographic_height", *LENS_FIELDS)}
