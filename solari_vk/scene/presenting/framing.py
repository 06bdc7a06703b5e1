"""The camera of a scene without one: objects are seen from above at an angle, rooms from inside."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from solari_vk.scene.camera import Camera
from solari_vk.scene.matrices import rotation
from solari_vk.scene.presenting.enclosures import (
    Dome,
    Floats,
    extent,
    find_dome,
    find_room,
    largest_triangles,
    open_side,
    trace,
)
from solari_vk.scene.presenting.lamplight import lit_shell

if TYPE_CHECKING:
    from solari_vk.scene.animation.clip import Animation
    from solari_vk.scene.lights.light import Light
    from solari_vk.scene.objects import Instance

VIEW = (-0.55, -0.4, -1.0)  # the direction in which objects are seen: a three-quarter view from above
OBJECT_FOV, ROOM_FOV = math.radians(35), math.radians(65)
MARGIN = 1.08
CLIP_POSES = 17  # of a clip, that a camera for it must show
DIRECTIONS = 400
WIDEST_FOV = math.radians(100)  # in a dome that leaves no room to step back


def poses(
    scene: Any, shown_instances: Callable[[], list[Instance]], clip: Animation | None
) -> Iterator[list[Instance]]:
    """The instances that a camera for a scene shows, in poses of a clip; the scene stays in the last, the start."""
    if clip is None:
        yield shown_instances()
        return
    for seconds in np.linspace(clip.duration, 0, CLIP_POSES):
        clip.apply(scene, seconds, loop=False)
        yield shown_instances()


def default_camera(
    poses: Iterable[list[Instance]], aspect: float, turns: Iterable[float] = (0.0,), lights: Iterable[Light] = ()
) -> Camera | None:
    """A camera that shows instances in several poses, of which the last one stays; None if there are no instances.

    aspect: width / height of the picture. turns: angles, in radians about the vertical axis through their middle, by
    which the camera will be turned, from where objects that stand alone are seen whole too. A room is seen from inside,
    as is a shell that keeps its light, of lights or of its own, inside; a box without a front through the open side,
    and what is in a dome from within the dome.
    """
    visible: list[Instance] = []
    points: list[Floats] = []
    dome: Dome | None = None
    for shown in poses:
        if not shown:
            continue
        dome = dome if visible else find_dome(shown)
        visible = shown
        inside = [instance for instance in shown if dome is None or instance in dome.inside]
        points.append(extent(inside or shown))
    if not visible:
        return None
    every = np.concatenate(points)
    if dome is not None:
        return _in_dome(fit(every, np.array(VIEW), aspect), every, largest_triangles(dome.shells), aspect)
    middle = (every.min(axis=0) + every.max(axis=0)) / 2
    opening = open_side(middle, largest_triangles(visible))
    if opening is not None:
        return _around(every, list(turns), aspect, -opening)
    room = find_room(visible, every)
    if room is not None:
        return _inside(room.center, room.triangles)
    camera = _around(every, list(turns), aspect, np.array(VIEW))
    shell = lit_shell(camera, visible, lights, every)
    return camera if shell is None else _inside(shell.center, shell.triangles)


def _around(points: Floats, turns: list[float], aspect: float, view: Floats) -> Camera:
    """A camera with a view direction (3,) that shows points (N, 3) whole, also after it is turned by any of some angles
    about their middle."""
    center = (points.min(axis=0) + points.max(axis=0)) / 2
    if len(turns) > 1:
        points = _outermost(points)
    # In place of the camera the points turn, the other way around.
    seen = np.concatenate([(points - center) @ rotation((0, 1, 0), turn) for turn in turns])
    if len(turns) > 1:
        # With all points and their mirror images the axis is in the middle of the picture. Otherwise what turns would
        # wander from side to side.
        right = np.cross(view, (0, 1, 0))
        mirrored = seen - 2 / (right @ right) * np.outer(seen @ right, right)
        seen = np.concatenate([seen, mirrored])
    return fit(seen + center, view, aspect)


def _outermost(points: Floats) -> Floats:
    """Of points (N, 3) those that are the farthest in any of many directions."""
    # The directions are a lattice of Fibonacci's, which covers a sphere evenly.
    number = np.arange(DIRECTIONS)
    height = 1 - (2 * number + 1) / DIRECTIONS
    turn = math.pi * (1 + math.sqrt(5)) * number
    level = np.sqrt(1 - height**2)
    directions = np.stack([level * np.cos(turn), height, level * np.sin(turn)], axis=1)
    found: Floats = points[np.unique([int(np.argmax(points @ direction)) for direction in directions])]
    return found


def fit(points: Floats, direction: Floats, aspect: float) -> Camera:
    """The nearest camera with a view direction that has all points (N, 3) in its picture, which they touch."""
    camera = Camera.look_at(-direction, (0, 0, 0), vertical_fov=OBJECT_FOV)
    axes = camera.transform[:3, :3]
    x, y, z = (points @ axes).T
    slope = math.tan(OBJECT_FOV / 2) / MARGIN
    extent = float(np.linalg.norm(np.ptp(points, axis=0))) or 1.0
    height = z.max() + 1e-2 * extent
    for across, tangent in ((x, slope * aspect), (y, slope)):
        # A point is inside the picture's edges if |across - eye| <= tangent * (height - z).
        height = max(height, ((across + tangent * z).max() + (tangent * z - across).max()) / (2 * tangent))
    transform = camera.transform.copy()
    # The height is that of the nearest camera whose picture is wide enough; where it is wider than needed, the points
    # are in its middle.
    transform[:3, 3] = axes @ (_middle(x, height - z), _middle(y, height - z), height)
    camera.update(transform=transform, near=max(1e-4 * extent, 1e-9))
    return camera


def _middle(across: Floats, depth: Floats) -> float:
    """The position from which the points are seen as far on one side of the picture's center as on the other."""
    low, high = float(across.min()), float(across.max())
    # Bisection: after 40 halvings the rest is below the precision of 32 bits.
    for _ in range(40):
        middle = (low + high) / 2
        seen = (across - middle) / depth
        low, high = (middle, high) if seen.max() > -seen.min() else (low, middle)
    return (low + high) / 2


def _in_dome(camera: Camera, points: Floats, triangles: Floats, aspect: float) -> Camera:
    """The camera, moved towards the points (N, 3) and with a wider view if triangles (M, 3, 3) would stand between."""
    center = (points.min(axis=0) + points.max(axis=0)) / 2
    eye = camera.transform[:3, 3].astype(np.float64)
    # Rays from the middle of what is shown: the camera stays well within the dome.
    free = 0.9 * float(trace(center, (eye - center)[None], triangles).distance[0])
    if free >= 1:
        return camera
    transform = camera.transform.copy()
    transform[:3, 3] = center + free * (eye - center)
    x, y, z = ((points - transform[:3, 3]) @ transform[:3, :3]).T
    slopes = np.maximum(np.abs(y), np.abs(x) / aspect) / np.maximum(-z, 1e-9)
    fov = min(2 * math.atan(float(slopes.max()) * MARGIN), WIDEST_FOV)
    camera.update(transform=transform, vertical_fov=fov, near=camera.near * free)
    return camera


def _inside(center: Floats, triangles: Floats) -> Camera:
    """A camera in a room: at one end of the longest way through the center, towards the other end."""
    # 48 level directions, of which 24 steps are half a turn.
    turns = 2 * math.pi * np.arange(48) / 48
    level = np.stack([np.sin(turns), 0 * turns, np.cos(turns)], axis=1)
    free = trace(center, level, triangles).distance
    # Windows and doors lead out of the bounds, where the way ends.
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.where(level > 0, (high - center) / level, np.where(level < 0, (low - center) / level, np.inf))
    leaves = np.isinf(free)
    free = np.minimum(free, ends.min(axis=1))
    ahead = int(np.argmax(free + np.roll(free, -24)))  # the opposite direction is half a turn away
    opposite = (ahead + 24) % 48
    # Towards the wall rather than the opening, else along the longer way.
    is_closed_there = leaves[ahead] and not leaves[opposite]
    is_longer_there = leaves[ahead] == leaves[opposite] and free[opposite] > free[ahead]
    if is_closed_there or is_longer_there:
        ahead = opposite
    behind = free[(ahead + 24) % 48]
    # Not at the wall itself, which would be cut by the near plane.
    eye = center - 0.8 * behind * level[ahead]
    target = center + 0.8 * free[ahead] * level[ahead]
    target[1] -= 0.1 * (free[ahead] + behind)
    return Camera.look_at(eye, target, vertical_fov=ROOM_FOV, near=max(1e-3 * float(behind + free[ahead]), 1e-9))
