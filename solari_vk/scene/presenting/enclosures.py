"""What encloses a camera or an object: rooms, and domes such as a modelled sky. Rays decide."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene.bounds import Bounds
from solari_vk.scene.matrices import transform_points

if TYPE_CHECKING:
    from solari_vk.scene.camera import Camera
    from solari_vk.scene.objects import Instance, Mesh

Floats = NDArray[np.float64]
MAX_POINTS = 2**20  # beyond that the corners of bounding boxes stand for vertices
MAX_TRIANGLES = 2**16  # that rays see: the largest
DIRECTION_COUNT = 192
FEW_DIRECTIONS = 24  # for a first test, which decides most places
SLACK_OF_FEW = 0.25  # by which this test lowers the shares below, since few directions say them roughly
# The center of a room sees front faces in this share of directions, and has a ceiling at a height in meters. Jars and
# boxes enclose their center too, but are smaller.
ROOM_SHARE = 0.8
LOWEST_ROOM, HIGHEST_ROOM = 1.8, 100.0
# Shares of directions.
OUTSIDE_SHARE = 0.5  # in which a shell shows its front to a viewer who walks around it
FURNISHED_SHARE = 0.05  # in which rays meet a second front face, in a room with something in it
FLOOR_SHARE = 0.5  # of steep rays that meet a level surface, if it is a floor
DOME_SHARE = 0.4  # in which a dome is seen, also one without its lower half
CLOSED_SHARE = 0.95  # in which something is met, where no light gets in
MOST_INSIDE = 0.7  # of a dome's size, for what it is the background of
LEAST_OPEN, MOST_OPEN = 0.08, 0.45  # that lead out of a box without a front
ONE_SIDED = 0.6  # the length of the mean of the directions through one opening
STEEP = 0.6  # the sine of a steep view
LEVEL = 0.97  # the cosine of the slope of a level surface
# Where a room is looked for: shares of the scene's bounds, and a height above them in meters that replaces the share.
PLACES = (((0.5, 0.5, 0.5), None), *(((x, 0.0, z), 1.6) for x in (0.5, 0.25, 0.75) for z in (0.5, 0.25, 0.75)))


class Seen(NamedTuple):
    """What rays from a point meet, for each of N directions."""

    distance: Floats
    """To the nearest triangle in meters, (N,); infinite without one."""
    front: NDArray[np.bool_]
    """Whether it is hit at its front, (N,)."""
    normal: Floats
    """Its unit normal, (N, 3); zero without a triangle."""
    fronts: NDArray[np.intp]
    """How many triangles lie along the ray with their front towards the point, (N,)."""


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


class Dome(NamedTuple):
    """Instances that are a background around others, such as a modelled sky."""

    shells: list[Instance]
    inside: list[Instance]


def find_room(instances: list[Instance], points: Floats) -> Room | None:
    """A room among visible instances, and points (N, 3) that are theirs; None if there is none.

    Rays from the center of the points, and from some places at the height of a visitor's eyes, decide whether the
    instances enclose the place by their front faces. What shows front faces to the outside too, such as a house, a jar
    or a cave in a rock, is a room only with a flat floor, a ceiling at a room's height, and something in it.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    triangles = largest_triangles(instances)
    outside: bool | None = None
    for share, height in PLACES:
        place = low + np.array(share) * (high - low)
        if height is not None:
            place[1] = low[1] + height
        # The cheapest test first: a floor and a ceiling, then a few directions, then all.
        below, above = trace(place, np.array([[0, -1.0, 0], [0, 1, 0]]), triangles).distance.tolist()
        if not math.isfinite(below + above):
            continue
        if trace(place, _directions(FEW_DIRECTIONS), triangles).front.mean() < ROOM_SHARE - SLACK_OF_FEW:
            continue
        seen = trace(place, _directions(DIRECTION_COUNT), triangles)
        if seen.front.mean() < ROOM_SHARE:
            continue
        # What is seen from outside is the same for all places, and costly.
        if outside is None:
            outside = _has_outside(place, triangles)
        furnished = (seen.fronts > 1).mean() >= FURNISHED_SHARE
        if not outside or (furnished and LOWEST_ROOM <= below + above <= HIGHEST_ROOM and _is_flat(seen, -1)):
            return Room(place, below, above, triangles)
    return None


def closed_place(instances: list[Instance], points: Floats) -> Room | None:
    """A place at which instances enclose a viewer on all sides, from whichever side they are seen; None without one.

    Places are those of `find_room`."""
    low, high = points.min(axis=0), points.max(axis=0)
    triangles = largest_triangles(instances)
    few = _directions(FEW_DIRECTIONS)
    all_around = _directions(DIRECTION_COUNT)
    for share, height in PLACES:
        place = low + np.array(share) * (high - low)
        if height is not None:
            place[1] = low[1] + height
        if not np.isfinite(trace(place, few, triangles).distance).all():
            continue
        if np.isfinite(trace(place, all_around, triangles).distance).mean() >= CLOSED_SHARE:
            below, above = trace(place, np.array([[0, -1.0, 0], [0, 1, 0]]), triangles).distance.tolist()
            return Room(place, below, above, triangles)
    return None


def open_side(center: Floats, triangles: Floats) -> Floats | None:
    """The level direction (3,) in which triangles around a point leave their one large opening, None if they don't."""
    directions = _directions(DIRECTION_COUNT)
    leaving = directions[~np.isfinite(trace(center, directions, triangles).distance)]
    if not LEAST_OPEN <= len(leaving) / DIRECTION_COUNT <= MOST_OPEN:
        return None
    middle: Floats = leaving.mean(axis=0)
    # Several openings, or one above, leave a short or a steep mean.
    if math.hypot(middle[0], middle[2]) < ONE_SIDED:
        return None
    middle[1] = 0
    middle /= np.linalg.norm(middle)
    # Most boxes stand along the axes, and the directions aren't quite symmetric.
    return np.round(middle) if np.abs(middle).max() > LEVEL else middle


def find_dome(instances: list[Instance]) -> Dome | None:
    """Visible instances that are a background, and what is in it; None without a background or without anything in it.

    A dome shows its front to the inside only; if it is unlit, either side. A hull at a room's height with a flat floor
    or ceiling is a room, unless it is unlit.
    """
    if len(instances) < 2:
        return None
    # Only what is larger than half of all counts as a background, and only the outermost of such instances.
    lows, highs = np.array([_box(instance) for instance in instances]).swapaxes(0, 1)
    sizes = np.linalg.norm(highs - lows, axis=1)
    whole = np.linalg.norm(highs.max(axis=0) - lows.min(axis=0))
    slack = 0.01 * sizes[:, None]
    shells, inside = np.zeros((2, len(instances)), np.bool_)
    for index in np.flatnonzero(sizes > whole / 2):
        low, high = lows[index], highs[index]
        within = ((lows >= low - slack[index]) & (highs <= high + slack[index])).all(1) & (
            sizes < MOST_INSIDE * sizes[index]
        )
        around = ((lows < low) & (highs > high)).all(1)
        if within.any() and not around.any() and _is_dome(instances[index], low, high):
            shells[index] = True
            inside |= within
    if not (inside & ~shells).any():
        return None
    parts = [[instances[index] for index in np.flatnonzero(which)] for which in (shells, inside & ~shells)]
    return Dome(*parts)


def place_of(camera: Camera, instances: list[Instance]) -> tuple[Room, bool]:
    """The surroundings of a camera, and whether instances enclose it so that no light from outside reaches it.

    What is above the camera counts up to the distance of what it looks at.
    """
    eye, back = (camera.transform[:3, column].astype(np.float64) for column in (3, 2))
    triangles = largest_triangles(instances)
    below, above, ahead = trace(eye, np.array([[0, -1.0, 0], [0, 1, 0], -back]), triangles).distance.tolist()
    closed = np.isfinite(trace(eye, _directions(DIRECTION_COUNT), triangles).distance).mean() >= CLOSED_SHARE
    extent = float(np.linalg.norm(np.ptp(triangles.reshape(-1, 3), axis=0)))
    above = min(above, ahead, extent)
    return Room(eye, min(below, above), above, triangles), bool(closed)


def _is_dome(instance: Instance, low: Floats, high: Floats) -> bool:
    center = (low + high) / 2
    triangles = largest_triangles([instance])
    few = trace(center, _directions(FEW_DIRECTIONS), triangles)
    if (np.isfinite(few.distance) if instance.material.unlit else few.front).mean() < DOME_SHARE - SLACK_OF_FEW:
        return False
    seen = trace(center, _directions(DIRECTION_COUNT), triangles)
    if instance.material.unlit:
        return bool(np.isfinite(seen.distance).mean() >= DOME_SHARE)
    is_hull = high[1] - low[1] <= HIGHEST_ROOM and (_is_flat(seen, -1) or _is_flat(seen, 1))
    return bool(seen.front.mean() >= DOME_SHARE and not is_hull and not _has_outside(center, triangles))


def _is_flat(seen: Seen, up: int) -> bool:
    """Whether what rays in all `_directions` meet below (up = -1) or above (1) is mostly horizontal."""
    facing = -up * seen.normal[up * _directions(len(seen.normal))[:, 1] > STEEP, 1]
    return bool((facing > LEVEL).mean() >= FLOOR_SHARE)


def _has_outside(center: Floats, triangles: Floats) -> bool:
    """Whether a viewer who walks around the triangles sees front faces towards a point (3,) in most directions."""
    # From outside of all, but not from far below, where the ground is.
    far = 2 * np.linalg.norm(triangles.reshape(-1, 3) - center, axis=1).max()
    around = [direction for direction in _directions(48) if direction[1] > -0.2]
    seen = [trace(center + far * direction, -direction[None], triangles).front[0] for direction in around]
    return bool(np.mean(seen) >= OUTSIDE_SHARE)


def _box(instance: Instance) -> Floats:
    """The lowest and the highest corner of the bounds of an instance, (2, 3)."""
    positions = instance.posed_mesh().positions
    placed = transform_points(instance.transform, Bounds(positions.min(axis=0), positions.max(axis=0)).corners)
    return np.array((placed.min(axis=0), placed.max(axis=0)), np.float64)


def trace(origin: Floats, directions: Floats, triangles: Floats) -> Seen:
    """What is seen from a point (3,) in directions (N, 3), of triangles given by their corners (M, 3, 3).

    Möller and Trumbore, "Fast, Minimum Storage Ray/Triangle Intersection" (1997).
    """
    corner = triangles[:, 0]
    edges = triangles[:, 1:] - corner[:, None]
    normal = np.cross(edges[:, 0], edges[:, 1])
    offset = origin - corner
    turned = np.cross(offset, edges[:, 0]), np.cross(edges[:, 1], offset)
    ahead = (edges[:, 1] * turned[0]).sum(axis=1)
    seen = Seen(
        *(np.full(len(directions), np.inf), np.zeros(len(directions), np.bool_)),
        np.zeros((len(directions), 3)),
        np.zeros(len(directions), np.intp),
    )
    # A direction at a time: all at once would take N x M vectors.
    with np.errstate(divide="ignore", invalid="ignore"):
        for index, direction in enumerate(directions):
            facing = normal @ direction
            u, v = turned[1] @ direction / -facing, turned[0] @ direction / -facing
            t = np.where((u >= 0) & (v >= 0) & (u + v <= 1), ahead / -facing, np.inf)
            # Also NaN, of triangles that the ray is parallel to.
            t[~(t > 0)] = np.inf
            nearest = int(np.argmin(t)) if len(t) else 0
            if len(t) and np.isfinite(t[nearest]):
                seen.distance[index] = t[nearest]
                seen.front[index] = facing[nearest] < 0
                seen.normal[index] = normal[nearest] / np.linalg.norm(normal[nearest])
                seen.fronts[index] = (np.isfinite(t) & (facing < 0)).sum()
    return seen


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
        box = Bounds(positions.min(axis=0), positions.max(axis=0))
        points.append(transform_points(instance.transform, positions if every else box.corners))
    return np.concatenate(points).astype(np.float64)


def largest_triangles(instances: list[Instance], seen_from: Floats | None = None) -> Floats:
    """Corners (N, 3, 3) of the largest triangles of each instance, as many in proportion to how many it has.

    seen_from: an eye (3,), for which those that hide their back are left out where it sees that."""
    share = MAX_TRIANGLES / max(sum(len(instance.mesh.triangles) for instance in instances), 1)
    largest: dict[Mesh, Floats] = {}
    corners = [np.zeros((0, 3, 3))]
    for instance in instances:
        mesh = instance.mesh
        if mesh not in largest:
            found = mesh.positions[mesh.triangles]
            # A box keeps its twelve triangles.
            count = max(math.ceil(len(found) * share), 12)
            if count < len(found):
                area = np.linalg.norm(np.cross(found[:, 1] - found[:, 0], found[:, 2] - found[:, 0]), axis=1)
                found = found[np.argpartition(-area, count)[:count]]
            largest[mesh] = found.astype(np.float64)
        placed = transform_points(instance.transform, largest[mesh])
        # A transform that mirrors turns the winding order around.
        placed = placed[:, ::-1] if np.linalg.det(instance.transform[:3, :3]) < 0 else placed
        if seen_from is not None and instance.material.hides_back:
            a, b, c = placed.swapaxes(0, 1)
            placed = placed[(np.cross(b - a, c - a) * (seen_from - a)).sum(axis=1) > 0]
        corners.append(placed)
    return np.concatenate(corners)
