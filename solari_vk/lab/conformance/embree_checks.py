"""Random rays against Embree: both must hit the same triangle, except where rounding decides."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.spatial_order import spatial_order
from solari_vk.lab.conformance.outcomes import VULKAN, Measurement, Rule
from solari_vk.lab.embree import embree_scene, intersect_planes
from solari_vk.lab.shader_runner import ShaderRunner
from solari_vk.lab.structures import IDENTITY, Placement, Structures, Triangles, bumpy_ball, random_rotation, trace
from solari_vk.scene.matrices import transform_points

SCENES = ("soup", "instanced", "mesh of a million")
_NEAR = 1e-4  # share of the scene's extent; closer to an edge than this, either triangle may be the hit
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


def measure(shaders: ShaderRunner, scene: str, count: int, small: bool = False) -> Iterator[Measurement]:
    """Trace `count` random rays through the bounds of a scene. `small` asks for a smaller scene, for tests."""
    shapes, placed = _scene(scene, small)
    parts = [transform_points(item.matrix, shapes[item.shape][0].placed) for item in placed]
    corners = np.concatenate(parts)
    first = np.concatenate([[0], np.cumsum([len(part) for part in parts])])  # each instance's first triangle
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
            # A driver that answers with numbers out of range must count as wrong, not as an IndexError.
            instance = np.minimum(hits["instance"], len(placed) - 1)
            triangle = first[instance] + np.minimum(hits["primitive"], len(corners))
            found = np.where(hits["t"] < 0, -1, np.minimum(triangle, len(corners) - 1))
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
