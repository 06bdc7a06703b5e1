"""Random rays against Embree: both must hit the same triangle, except where rounding decides."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.spatial_order import spatial_order
from solari_vk.lab.conformance.bulk_checks import bumpy_ball, trace, turn
from solari_vk.lab.conformance.rules import VULKAN, Measurement, Rule
from solari_vk.lab.conformance.shader_runner import ShaderRunner
from solari_vk.lab.conformance.worlds import IDENTITY, Placed, Triangles, World
from solari_vk.scene.matrices import transform_points

SCENES = ("soup", "instanced", "mesh of a million")
_NEAR = 1e-4  # share of the scene's extent; closer to an edge than this, either triangle may be the hit
_BATCH = 1 << 18


def available() -> bool:
    """Whether Embree's Python package is installed and works."""
    try:
        importlib.import_module("embreex.rtcore_scene")
    except ImportError:
        return False
    return True


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


def _scene(name: str, small: bool) -> tuple[dict[str, list[Triangles]], list[Placed]]:
    random = np.random.default_rng(15)
    if name == "soup":
        return {"soup": [Triangles(_soup(random, 5_000 if small else 50_000))]}, [Placed("soup")]
    if name == "mesh of a million":
        return {"mesh": [Triangles(bumpy_ball(708, 0.02))]}, [Placed("mesh")]
    shapes = {"ball": [Triangles(bumpy_ball(12, 0.3))], "soup": [Triangles(_soup(random, 100))]}
    places = random.uniform(-6, 6, (200 if small else 1000, 3))
    placed = []
    for i, at in enumerate(places[spatial_order(places)]):
        matrix = IDENTITY.copy()
        matrix[:, :3] = turn(random) @ np.diag(random.uniform(0.3, 1.5, 3) * random.choice((-1, 1), 3))
        matrix[:, 3] = at
        placed.append(Placed(("ball", "soup")[i % 2], matrix))
    return shapes, placed


def embree_scene(corners: NDArray[Any]) -> Any:
    """Embree's scene of triangles (T, 3, 3); its `run(origins, directions)` gives the closest one's index, or -1."""
    scene = importlib.import_module("embreex.rtcore_scene").EmbreeScene(robust=True)
    vertices = corners.reshape(-1, 3).astype(np.float32)
    indices = np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
    importlib.import_module("embreex.mesh_construction").TriangleMesh(scene, vertices, indices)
    return scene


def meet(
    corners: NDArray[Any], index: NDArray[Any], origins: NDArray[Any], directions: NDArray[Any]
) -> tuple[Any, Any]:
    """t at the planes of triangles (N,) in float64, and the distance to the nearest edge; inf for index -1."""
    t, edge = np.full(len(index), np.inf), np.full(len(index), np.inf)
    hit = np.flatnonzero(index >= 0)
    hits = corners[index[hit]], origins[hit], directions[hit]
    corners, origins, directions = (values.astype(np.float64) for values in hits)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    with np.errstate(divide="ignore", invalid="ignore"):
        t[hit] = _dot(corners[:, 0] - origins, normal) / _dot(directions, normal)
        points = origins + t[hit, None] * directions
    for i in range(3):
        along = corners[:, (i + 1) % 3] - corners[:, i]
        part = np.clip(_dot(points - corners[:, i], along) / np.maximum(_dot(along, along), 1e-300), 0, 1)
        apart = np.linalg.norm(points - corners[:, i] - part[:, None] * along, axis=1)
        edge[hit] = np.fmin(edge[hit], apart)
    return t, edge


def _dot(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    return np.einsum("ij,ij->i", a, b)  # type: ignore[no-any-return]


def measure(shaders: ShaderRunner, scene: str, count: int, small: bool = False) -> Iterator[Measurement]:
    """Trace `count` random rays through the bounds of a scene. `small` asks for a smaller scene, for tests."""
    shapes, placed = _scene(scene, small)
    parts = [transform_points(item.matrix, shapes[item.shape][0].placed) for item in placed]
    corners = np.concatenate(parts)
    first = np.concatenate([[0], np.cumsum([len(part) for part in parts])])  # each instance's first triangle
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    middle, half, extent = (low + high) / 2, (high - low) / 2, float(np.linalg.norm(high - low))
    oracle = embree_scene(corners)
    random = np.random.default_rng(16)
    unexcused = excused = 0
    worst = 0.0
    with World(shaders.device, shapes, placed) as world:
        for start in range(0, count, _BATCH):
            size = min(_BATCH, count - start)
            origins = (middle + random.uniform(-1.5, 1.5, (size, 3)) * half).astype(np.float32)
            targets = middle + random.uniform(-0.9, 0.9, (size, 3)) * half
            directions = (targets - origins).astype(np.float32)
            directions /= np.linalg.norm(directions, axis=1, keepdims=True)
            hits = trace(shaders, world.tlas, origins, directions)
            found = np.where(
                hits["t"] < 0,
                -1,
                first[np.minimum(hits["instance"], len(placed) - 1)] + np.minimum(hits["primitive"], len(corners)),
            )
            found = np.minimum(found, len(corners) - 1)
            right = oracle.run(origins, directions)
            t_found, edge_found = meet(corners, found, origins, directions)
            t_right, edge_right = meet(corners, right, origins, directions)
            differs = found != right
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
