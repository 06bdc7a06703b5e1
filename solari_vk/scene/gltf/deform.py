"""The rest pose of morphed and skinned meshes, baked into their vertices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene.gltf.accessors import Accessors
from solari_vk.scene.gltf.values import Entry

Vertices = dict[str, NDArray[np.float32]]  # by attribute: "POSITION", "NORMAL", "TANGENT", ...


@dataclass(frozen=True)
class Pose:
    """How a node deforms its mesh. Poses are the same if their keys are equal."""

    key: Any = None
    weights: tuple[float, ...] = ()
    joints: NDArray[np.float64] | None = None  # (J, 4, 4), from vertices to world space


def morph(vertices: Vertices, targets: Sequence[Entry], weights: Sequence[float], accessors: Accessors) -> Vertices:
    """The vertices plus the weighted displacements of the targets."""
    result = dict(vertices)
    for target, weight in zip(targets, weights, strict=False):
        for name in ("POSITION", "NORMAL", "TANGENT"):
            index = target.index(name)
            if index is None or weight == 0 or name not in vertices:
                continue
            moved = accessors.floats(index, target, ("VEC3",))
            if len(moved) != len(vertices[name]):
                raise target.error(
                    f"moves {len(moved)} vertices, but there are {len(vertices[name])}; export the file again"
                )
            sum_of_both = result[name].copy()
            sum_of_both[:, :3] += np.float32(weight) * moved
            result[name] = sum_of_both
    return result


def skin(vertices: Vertices, attributes: Entry, joints: NDArray[np.float64], accessors: Accessors) -> Vertices:
    """The vertices in world space, moved by their joints."""
    count = len(vertices["POSITION"])
    blended = np.zeros((count, 4, 4))
    total = np.zeros(count)
    number = 0
    while f"JOINTS_{number}" in attributes:
        indices = accessors.integers(attributes.integer(f"JOINTS_{number}"), attributes, ("VEC4",))
        weights = accessors.floats(attributes.integer(f"WEIGHTS_{number}"), attributes, ("VEC4",))
        if not len(indices) == len(weights) == count:
            raise attributes.error(f"has {len(indices)} joints and {len(weights)} weights for {count} positions")
        for column in range(4):
            used = weights[:, column] != 0
            if used.any() and int(indices[used, column].max()) >= len(joints):
                raise attributes.error(
                    f"refers to joint {indices[used, column].max()}, but the skin has {len(joints)} joints"
                )
            blended[used] += weights[used, column, None, None] * joints[indices[used, column]]
            total += weights[:, column]
        number += 1
    blended /= np.where(total > 0, total, 1)[:, None, None]
    blended[total <= 0] = np.eye(4)
    linear = blended[:, :3, :3]
    result = dict(vertices)
    result["POSITION"] = (_apply(linear, vertices["POSITION"]) + blended[:, :3, 3]).astype(np.float32)
    if "NORMAL" in vertices:
        # The cofactor matrix rotates normals like the inverse transpose, and exists for singular joints too.
        cofactors = np.cross(linear[:, [1, 2, 0]], linear[:, [2, 0, 1]])
        result["NORMAL"] = _apply(cofactors, vertices["NORMAL"]).astype(np.float32)
    if "TANGENT" in vertices:
        tangents = vertices["TANGENT"].copy()
        tangents[:, :3] = _apply(linear, tangents[:, :3]).astype(np.float32)
        result["TANGENT"] = tangents
    return result


def _apply(matrices: NDArray[np.float64], vectors: NDArray[np.float32]) -> NDArray[np.float64]:
    product: NDArray[np.float64] = np.einsum("nij,nj->ni", matrices, vectors)
    return product
