"""Random rays against Embree: both must hit the same triangle, except where rounding decides."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.spatial_order import spatial_order
from solari_vk.lab.conformance.outcomes import VULKAN, Measurement, Rule
from solari_vk.lab.embree import embree_scene, intersect_planes
from solari_vk.lab.shader_runner import ShaderRunner
from solari_vk.lab.structures import (
    IDENTITY,
    Placement,
    Shapes,
    Structures,
    Triangles,
    bumpy_ball,
    random_rotation,
    trace,
)
from solari_vk.scene.builtin import builtin
from solari_vk.scene.matrices import transform_points
from solari_vk.scene.model import Scene

SCENES = ("soup", "instanced", "mesh of a million")
BUILTIN = ("cornell_box", "many_lights", "rooms", "sphere_grid")
AIMS = ("anywhere", "at edges", "at vertices")
_NEAR = 1e-4  # share of the scene's extent; closer to an edge than this, either triangle may be the hit
_BESIDE = 1e-6  # share of the scene's extent: rays that are so close to each other may hit what either of them hits
# Rays of one dispatch: enough to fill a GPU, few enough to fit into memory.
_BATCH = 1 << 18


def rules(scene: str) -> list[Rule]:
    """The rules that `measure` measures on a scene."""
    section = "Ray Closest Hit Determination"
    return [
        Rule(f"{scene}: the closest hit is Embree's, except at edges", VULKAN, section),
        Rule(f"{scene}: few hits differ at edges", VULKAN, section),
        Rule(f"{scene}: t of the hit is that of float64 arithmetic", VULKAN, section),
    ]


def _soup(random: np.random.Generator, count: int) -> NDArray[np.float64]:
    centers = random.uniform(-1, 1, (count, 3))
    centers = centers[spatial_order(centers)]
    return centers[:, None] + random.normal(size=(count, 3, 3)) * 0.04


def _scene(name: str, small: bool) -> tuple[dict[str, list[Triangles]], list[Placement]]:
    random = np.random.default_rng(15)
    if name == "soup":
        return {"soup": [Triangles(_soup(random, 5_000 if small else 50_000))]}, [Placement("soup")]
    if name == "mesh of a million":
        return {"mesh": [Triangles(bumpy_ball(708, 0.02))]}, [Placement("mesh")]
    shapes = {"ball": [Triangles(bumpy_ball(12, 0.3))], "soup": [Triangles(_soup(random, 100))]}
    places = random.uniform(-6, 6, (200 if small else 1000, 3))
    placed = []
    for i, at in enumerate(places[spatial_order(places)]):
        matrix = IDENTITY.copy()
        matrix[:, :3] = random_rotation(random) @ np.diag(random.uniform(0.3, 1.5, 3) * random.choice((-1, 1), 3))
        matrix[:, 3] = at
        placed.append(Placement(("ball", "soup")[i % 2], matrix))
    return shapes, placed


def _in_world(shapes: Shapes, placed: Sequence[Placement]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The corners of all triangles, and the first triangle of each instance with their number at the end."""
    parts = []
    for item in placed:
        [part] = shapes[item.shape]
        assert isinstance(part, Triangles)
        parts.append(transform_points(item.matrix, part.placed))
    return np.concatenate(parts), np.cumsum([0, *map(len, parts)])


def _triangles_of(hits: np.ndarray, first: NDArray[np.int64]) -> NDArray[np.int64]:
    """The numbers of hit triangles in the whole scene, -1 for none."""
    count = first[-1]
    # A driver that answers with numbers out of range must count as wrong, not as an IndexError.
    instance = np.minimum(hits["instance"], len(first) - 2)
    triangle = first[instance] + np.minimum(hits["primitive"], count)
    return np.where(hits["t"] < 0, -1, np.minimum(triangle, count - 1))


def measure(shaders: ShaderRunner, scene: str, count: int, small: bool = False) -> Iterator[Measurement]:
    """Trace `count` random rays through the bounds of a scene. `small` asks for a smaller scene, for tests."""
    shapes, placed = _scene(scene, small)
    corners, first = _in_world(shapes, placed)
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    middle = (low + high) / 2
    half = (high - low) / 2
    extent = float(np.linalg.norm(high - low))
    # The reference sees all instances as one mesh in world space.
    oracle = embree_scene(corners)
    random = np.random.default_rng(16)
    unexcused = excused = 0
    worst = 0.0
    with Structures(shaders.device, shapes, placed) as structures:
        for start in range(0, count, _BATCH):
            size = min(_BATCH, count - start)
            origins = (middle + random.uniform(-1.5, 1.5, (size, 3)) * half).astype(np.float32)
            targets = middle + random.uniform(-0.9, 0.9, (size, 3)) * half
            directions = (targets - origins).astype(np.float32)
            directions /= np.linalg.norm(directions, axis=1, keepdims=True)
            hits = trace(shaders, structures.tlas, origins, directions)
            found = _triangles_of(hits, first)
            right = oracle.run(origins, directions)
            t_found, edge_found = intersect_planes(corners, found, origins, directions)
            t_right, edge_right = intersect_planes(corners, right, origins, directions)
            differs = found != right
            # Two triangles at one distance, or beside a common edge: rounding decides between them.
            with np.errstate(invalid="ignore"):
                level = np.abs(t_found - t_right) <= 1e-6 * extent
            at_edge = np.fmin(edge_found, edge_right) <= _NEAR * extent
            unexcused += int((differs & ~at_edge & ~level).sum())
            excused += int((differs & (at_edge | level)).sum())
            same = ~differs & (found >= 0)
            worst = max(worst, float(np.abs(hits["t"] - t_found)[same].max(initial=0)) / extent)
    rule, edges, distance = rules(scene)
    yield Measurement(rule, unexcused / count, 1e-4, f"of {count:,} rays")
    yield Measurement(edges, excused / count, 1e-3, f"of {count:,} rays")
    yield Measurement(distance, worst, 1e-4, "of the extent")


# ---- exactly -----------------------------------------------------------------------------------------


def shapes_of(scene: Scene) -> tuple[dict[str, list[Triangles]], list[Placement]]:
    """What rays hit of a scene, as shapes and instances."""
    shapes: dict[str, list[Triangles]] = {}
    placed = []
    for instance in scene.instances:
        mesh = instance.ray_mesh or instance.posed_mesh()
        name = str(len(shapes)) if instance.posed else f"of {id(mesh)}"
        shapes.setdefault(name, [Triangles(mesh.positions[mesh.triangles])])
        placed.append(Placement(name, instance.transform[:3]))
    return shapes, placed


def exact_rules(name: str) -> list[Rule]:
    """The rules that `measure_exactly` measures on a scene."""
    section = "Ray Closest Hit Determination"
    return [
        *(Rule(f"{name}: rays {aim} hit what Embree hits", VULKAN, section) for aim in AIMS),
        Rule(f"{name}: hits lie in their triangles' planes", VULKAN, section),
    ]


def measure_exactly(shaders: ShaderRunner, scene: str | Scene, count: int, name: str = "") -> Iterator[Measurement]:
    """Trace `count` rays of each of AIMS: each must hit what Embree's does, or what Embree finds a millionth of the
    scene's extent beside it. So rays at outlines may pass on either side, but none gets between two triangles."""
    if isinstance(scene, Scene):
        shapes, placed = shapes_of(scene)
    else:
        shapes, placed = shapes_of(builtin(scene)) if scene in BUILTIN else _scene(scene, small=False)
    corners, first = _in_world(shapes, placed)
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    extent = float(np.linalg.norm(high - low))
    oracle, random = embree_scene(corners), np.random.default_rng(17)
    wrong = dict.fromkeys(AIMS, 0)
    off = 0.0
    with Structures(shaders.device, shapes, placed) as structures:
        for aim, start in itertools.product(AIMS, range(0, count, _BATCH)):
            size = min(_BATCH, count - start)
            origins = random.uniform(1.25 * low - 0.25 * high, 1.25 * high - 0.25 * low, (size, 3)).astype(np.float32)
            directions = (_targets(random, aim, corners, size) - origins).astype(np.float32)
            directions /= np.linalg.norm(directions, axis=1, keepdims=True)
            hits = trace(shaders, structures.tlas, origins, directions)
            found, right = _triangles_of(hits, first), oracle.run(origins, directions)
            some = np.flatnonzero(found != right)
            rays = origins[some], directions[some]
            wrong[aim] += _count_wrong(oracle, corners, first, found[some], right[some], *rays, _BESIDE * extent)
            off = max(off, _off_plane(corners, found, origins + hits["t"][:, None].astype(float) * directions))
    *aimed, plane = exact_rules(name or str(scene))
    for rule, aim in zip(aimed, AIMS, strict=True):
        yield Measurement(rule, wrong[aim], 0.0, f"of {count:,} rays")
    yield Measurement(plane, off / extent, _BESIDE, "of the extent")


def _targets(random: np.random.Generator, aim: str, corners: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    if aim == "anywhere":
        return random.uniform(corners.min(axis=(0, 1)), corners.max(axis=(0, 1)), (size, 3))
    triangle, corner = random.integers(len(corners), size=size), random.integers(3, size=size)
    one, other = corners[triangle, corner], corners[triangle, (corner + 1) % 3]
    along = random.random((size, 1)) if aim == "at edges" else 0.0
    return one + (other - one) * along


def _count_wrong(
    oracle: Any,
    corners: NDArray[np.float64],
    first: NDArray[np.int64],
    found: NDArray[np.int64],
    right: NDArray[Any],
    origins: NDArray[np.float32],
    directions: NDArray[np.float32],
    reach: float,
) -> int:
    """How many of the rays that don't hit Embree's triangles are wrong. reach: what they may pass beside a surface."""
    t, edge, cosine = _planes(corners, found, origins, directions)
    side = np.cross(directions, np.roll(directions, 1, axis=1) * (1, -1, 1))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    nearest, farthest, connected = np.full(len(t), np.inf), np.zeros(len(t)), np.ones(len(t), bool)
    for offset in (0 * side, side, -side, np.cross(side, directions), np.cross(directions, side)):
        moved = (origins + reach * offset).astype(np.float32)
        hit = oracle.run(moved, directions)
        beside, _, slope = _planes(corners, hit, moved, directions)
        nearest = np.fmin(nearest, beside - reach - reach / slope)
        farthest = np.fmax(farthest, beside + reach + reach / slope)
        connected &= np.searchsorted(first, hit, side="right") == np.searchsorted(first, right, side="right")
        connected &= (corners[hit][:, :, None] == corners[right][:, None]).all(axis=-1).any(axis=(1, 2))
    # Embree may pass beside what is hit at its edge, and rays may pass between meshes, or triangles that have no corner
    # in common, or beside a fold.
    too_far = (t - reach / cosine > farthest) & connected
    few = np.flatnonzero(too_far)[:20]  # where there are more, they aren't all beside folds
    too_far[few] = [not _is_at_fold(corners, corners[right[ray]], origins[ray], directions[ray]) for ray in few]
    return int(((t < nearest) & (edge * cosine > reach)).sum() + too_far.sum())


def _is_at_fold(
    corners: NDArray[np.float64], own: NDArray[np.float64], origin: NDArray[np.float32], direction: NDArray[np.float32]
) -> bool:
    """Whether the triangles around what a ray passes nearest to don't all face the same way: around a side of `own`
    (3, 3), or around its corner where the ray passes that about as near."""
    apart = np.linalg.norm(np.cross(own - origin, direction), axis=1)
    along = np.roll(own, -1, axis=0) - own
    # Of the ray from the line of each side.
    across = np.cross(along, direction)
    off = np.abs(((own - origin) * across).sum(axis=1)) / np.maximum(np.linalg.norm(across, axis=1), 1e-300)
    side, corner = off.argmin(), apart.argmin()
    shared = own[[corner]] if apart[corner] <= 10 * off[side] else own[[side, (side + 1) % 3]]
    around = np.all([(corners == point).all(axis=-1).any(axis=-1) for point in shared], axis=0)
    a, b, c = np.moveaxis(corners[around], 1, 0)
    facing = np.cross(b - a, c - a) @ direction > 0
    return bool(facing.any() and not facing.all())


def _planes(
    corners: NDArray[np.float64], index: NDArray[Any], origins: NDArray[np.float32], directions: NDArray[np.float32]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """`intersect_planes`, and the cosine of the angle between ray and normal, 1 without a triangle."""
    a, b, c = np.moveaxis(corners[index], 1, 0)
    normal = np.cross(b - a, c - a)
    length = np.maximum(np.linalg.norm(normal, axis=1), 1e-300)
    cosine = np.abs((normal * directions).sum(axis=1)) / length
    return *intersect_planes(corners, index, origins, directions), np.where(index < 0, 1.0, np.maximum(cosine, 1e-12))


def _off_plane(corners: NDArray[np.float64], found: NDArray[np.int64], points: NDArray[np.float64]) -> float:
    """How far hits (N, 3) are at most from the planes of their triangles."""
    a, b, c = np.moveaxis(corners[found[found >= 0]], 1, 0)
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    return float(np.abs(((points[found >= 0] - a) * normal).sum(axis=1)).max(initial=0))
