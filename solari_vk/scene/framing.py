"""The camera of a scene without one: objects are seen from above at an angle, rooms from inside."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene.camera import Camera
from solari_vk.scene.matrices import transform_points

if TYPE_CHECKING:
    from solari_vk.scene.objects import Instance, Mesh

Floats = NDArray[np.float64]
VIEW = (-0.55, -0.4, -1.0)  # the direction in which objects are seen: a three-quarter view from above
OBJECT_FOV, ROOM_FOV = math.radians(35), math.radians(65)
MARGIN = 1.08
MAX_POINTS = 2**20  # beyond that the corners of bounding boxes stand for vertices
MAX_TRIANGLES = 2**16  # that rays see: the largest
DIRECTION_COUNT = 192
# The center of a room sees front faces in this share of directions, and has a ceiling at a height in meters. Jars and
# boxes enclose their center too, but are smaller.
ROOM_SHARE = 0.8
LOWEST_ROOM, HIGHEST_ROOM = 1.8, 100.0
# Where a room is looked for: shares of the scene's bounds, and a height above them in meters that replaces the share.
PLACES = (((0.5, 0.5, 0.5), None), *(((x, 0.0, z), 1.6) for x in (0.5, 0.25, 0.75) for z in (0.5, 0.25, 0.75)))


def default_camera(instances: list[Instance], points: Floats, aspect: float) -> Camera:
    """A camera that shows visible instances, and points (N, 3) that are theirs. aspect: width / height of the picture.

    A room is seen from inside.
    """
    room = find_room(instances, points)
    return fit(points, VIEW, aspect) if room is None else _inside(room.center, room.triangles)


class Room(NamedTuple):
    """A point that walls, a floor and a ceiling enclose."""

    center: Floats
    """The point, (3,) in meters."""
    below: float
    """The distance to the floor, or what stands on it, in meters."""
    above: float
    """The distance to the ceiling, or what hangs from it, in meters."""
    triangles: Floats
    """Corners (N, 3, 3) of the scene's largest triangles."""


def find_room(instances: list[Instance], points: Floats) -> Room | None:
    """A room among visible instances, and points (N, 3) that are theirs; None if there is none.

    Rays from the center of the points, and from some places at the height of a visitor's eyes, decide whether the
    instances enclose the place.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    triangles = _largest_triangles(instances)
    for share, height in PLACES:
        place = low + np.array(share) * (high - low)
        if height is not None:
            place[1] = low[1] + height
        below, above = trace(place, np.array([[0, -1.0, 0], [0, 1, 0]]), triangles)[0].tolist()
        if LOWEST_ROOM <= below + above <= HIGHEST_ROOM:
            _, front = trace(place, _directions(DIRECTION_COUNT), triangles)
            if front.mean() >= ROOM_SHARE:
                return Room(place, below, above, triangles)
    return None


def fit(points: Floats, direction: tuple[float, float, float], aspect: float) -> Camera:
    """The nearest camera with a view direction that has all points (N, 3) in its picture, which they touch."""
    camera = Camera.look_at(-np.array(direction), (0, 0, 0), vertical_fov=OBJECT_FOV)
    axes = camera.transform[:3, :3]
    x, y, z = (points @ axes).T
    slope = math.tan(OBJECT_FOV / 2) / MARGIN
    extent = float(np.linalg.norm(np.ptp(points, axis=0))) or 1.0
    height = z.max() + 1e-2 * extent
    for across, tangent in ((x, slope * aspect), (y, slope)):
        # A point is inside the picture's edges if |across - eye| <= tangent * (height - z).
        height = max(height, ((across + tangent * z).max() + (tangent * z - across).max()) / (2 * tangent))
    transform = camera.transform.copy()
    transform[:3, 3] = axes @ (_middle(x, height - z), _middle(y, height - z), height)
    camera.update(transform=transform, near=max(1e-4 * extent, 1e-9))
    return camera


def _middle(across: Floats, depth: Floats) -> float:
    """The position from which the points are seen as far on one side of the picture's center as on the other."""
    low, high = float(across.min()), float(across.max())
    for _ in range(40):
        middle = (low + high) / 2
        seen = (across - middle) / depth
        low, high = (middle, high) if seen.max() > -seen.min() else (low, middle)
    return (low + high) / 2


def _inside(center: Floats, triangles: Floats) -> Camera:
    """A camera in a room: at one end of the longest way through the center, towards the other end."""
    turns = 2 * math.pi * np.arange(48) / 48
    level = np.stack([np.sin(turns), 0 * turns, np.cos(turns)], axis=1)
    free, _ = trace(center, level, triangles)
    longest = 4 * np.linalg.norm(np.ptp(triangles.reshape(-1, 3), axis=0))
    free = np.minimum(free, longest)
    ahead = int(np.argmax(free + np.roll(free, -24)))  # the opposite direction is half a turn away
    if free[ahead] < free[(ahead + 24) % 48]:
        ahead = (ahead + 24) % 48
    behind = free[(ahead + 24) % 48]
    eye = center - 0.8 * behind * level[ahead]
    target = center + 0.8 * free[ahead] * level[ahead]
    target[1] -= 0.1 * (free[ahead] + behind)
    return Camera.look_at(eye, target, vertical_fov=ROOM_FOV, near=max(1e-3 * float(behind + free[ahead]), 1e-9))


def trace(origin: Floats, directions: Floats, triangles: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Distances (N,) from a point (3,) to the nearest triangle in each direction (N, 3), and whether its front is hit.

    triangles: corners (M, 3, 3). Distances are infinite without a hit. Möller and Trumbore, "Fast, Minimum Storage
    Ray/Triangle Intersection" (1997).
    """
    corner = triangles[:, 0]
    edges = triangles[:, 1:] - corner[:, None]
    normal = np.cross(edges[:, 0], edges[:, 1])
    offset = origin - corner
    turned = np.cross(offset, edges[:, 0])
    ahead = (edges[:, 1] * turned).sum(axis=1)
    distance = np.full(len(directions), np.inf)
    front = np.zeros(len(directions), np.bool_)
    with np.errstate(divide="ignore", invalid="ignore"):
        for index, direction in enumerate(directions):
            facing = normal @ direction
            across = np.cross(direction, edges[:, 1])
            u, v = (offset * across).sum(axis=1) / -facing, turned @ direction / -facing
            t = np.where((u >= 0) & (v >= 0) & (u + v <= 1), ahead / -facing, np.inf)
            t[~(t > 0)] = np.inf
            nearest = int(np.argmin(t)) if len(t) else 0
            if len(t) and np.isfinite(t[nearest]):
                distance[index] = t[nearest]
                front[index] = facing[nearest] < 0
    return distance, front


def _directions(count: int) -> Floats:
    """Unit vectors (count, 3) spread evenly over the sphere: Fibonacci's lattice."""
    z = 1 - (2 * np.arange(count) + 1) / count
    turn = math.pi * (3 - math.sqrt(5)) * np.arange(count)
    ring = np.sqrt(1 - z * z)
    return np.stack([ring * np.cos(turn), z, ring * np.sin(turn)], axis=1)


def extent(instances: list[Instance]) -> Floats:
    """Points (N, 3) that have the extent of the instances: their vertices, or of many the corners of their boxes."""
    every = sum(len(instance.mesh.positions) for instance in instances) <= MAX_POINTS
    points = []
    for instance in instances:
        positions = instance.posed_mesh().positions
        low, high = positions.min(axis=0), positions.max(axis=0)
        corners = np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(-1, 3)
        points.append(transform_points(instance.transform, positions if every else corners))
    return np.concatenate(points).astype(np.float64)


def _largest_triangles(instances: list[Instance]) -> Floats:
    """Corners (N, 3, 3) of the largest triangles of each instance, as many in proportion to how many it has."""
    share = MAX_TRIANGLES / max(sum(len(instance.mesh.triangles) for instance in instances), 1)
    largest: dict[Mesh, Floats] = {}
    corners = []
    for instance in instances:
        mesh = instance.mesh
        if mesh not in largest:
            found = mesh.positions[mesh.triangles]
            count = max(math.ceil(len(found) * share), 12)
            if count < len(found):
                area = np.linalg.norm(np.cross(found[:, 1] - found[:, 0], found[:, 2] - found[:, 0]), axis=1)
                found = found[np.argpartition(-area, count)[:count]]
            largest[mesh] = found.astype(np.float64)
        placed = transform_points(instance.transform, largest[mesh])
        corners.append(placed[:, ::-1] if np.linalg.det(instance.transform[:3, :3]) < 0 else placed)
    return np.concatenate(corners)
