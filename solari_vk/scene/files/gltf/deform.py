"""The joints and morph targets of a primitive, as arrays with a row for each vertex."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene import checks
from solari_vk.scene.files.gltf.accessors import Accessors
from solari_vk.scene.files.gltf.report import Report
from solari_vk.scene.files.gltf.values import Entry
from solari_vk.scene.matrices import unit
from solari_vk.scene.meshes.deformation import Deformation
from solari_vk.scene.meshes.tangents import generate_tangents

Vertices = dict[str, NDArray[Any]]  # by attribute: "POSITION", "NORMAL", "TANGENT", ...
_MOST_SETS = 64  # of joints
_BYTES_PER_TRIANGLE = 300  # whose tangents are made
TARGETS = {"POSITION": "targets", "NORMAL": "target_normals", "TANGENT": "target_tangents"}
"""What a morph target adds to, and the field of `Deformation` that has it."""


def read_targets(vertices: Vertices, targets: Sequence[Entry], accessors: Accessors, report: Report) -> Vertices:
    """What each target adds (N, T, 3), by the field of `Deformation`, for the attributes that the vertices have. What
    is wrong adds nothing, and is reported."""
    found: Vertices = {}
    for name, field in TARGETS.items():
        if not any(name in target for target in targets) or name not in vertices:
            continue
        count = len(vertices[name])
        _charge(targets, count)
        added = np.zeros((count, len(targets), 3), np.float32)
        for number, target in enumerate(targets):
            with report.costs("morph targets with wrong values change nothing"):
                added[:, number] = _deltas(target, name, count, accessors)
        found[field] = added
    if found and "targets" not in found:
        _charge(targets, len(vertices["POSITION"]))
        # `Deformation` has positions for all targets, also if they turn normals alone.
        found["targets"] = np.zeros((len(vertices["POSITION"]), len(targets), 3), np.float32)
    return found


def _deltas(target: Entry, name: str, count: int, accessors: Accessors) -> Any:
    """What a target adds to an attribute of `count` vertices, (N, 3); 0 for an attribute that it leaves alone."""
    index = target.index(name)
    if index is None:
        return 0
    values = accessors.floats(index, target, ("VEC3",))
    if len(values) != count:
        raise target.error(f"moves {len(values)} vertices, but there are {count}; export the file again")
    limit = checks.LARGEST_COORDINATE
    if not np.abs(values).max(initial=0) <= limit:
        raise target.error(f"moves vertices by more than {limit:g} meters; scale it down")
    return values


def tangent_changes(
    vertices: Vertices, uvs: NDArray[Any], triangles: NDArray[np.uint32], targets: Sequence[Entry]
) -> NDArray[np.float32]:
    """What each target adds (N, T, 3) to tangents that were made for vertices: those of the mesh that it makes are made
    too (glTF 2.0, 3.7.2.2)."""
    positions, normals, tangents = (vertices[name] for name in ("POSITION", "NORMAL", "TANGENT"))
    _charge(targets, len(positions))
    added = np.zeros_like(vertices["targets"])
    for number, target in enumerate(targets):
        moved_positions, moved_normals = positions + vertices["targets"][:, number], normals
        if "target_normals" in vertices:
            moved_normals = normals + vertices["target_normals"][:, number]
        moved = ((moved_positions != positions) | (moved_normals != normals)).any(axis=1)
        # Most targets of a face move a small part of it. A tangent depends on all triangles of its vertex.
        changed = np.zeros(len(moved), bool)
        changed[triangles[moved[triangles].any(axis=1)]] = True
        near = triangles[changed[triangles].any(axis=1)]
        target.charge(0, "its tangents", working=_BYTES_PER_TRIANGLE * len(near))
        made = generate_tangents(moved_positions, unit(moved_normals), uvs, near)
        added[made.source, number] = made.tangents[:, :3] - tangents[made.source, :3]
        added[~changed, number] = 0
    return added


def _charge(targets: Sequence[Entry], count: int) -> None:
    """Charge what all targets add to one attribute of `count` vertices: three floats, and a copy while it is made."""
    size = 12 * count * len(targets)
    targets[0].charge(2 * size, f"{len(targets)} targets of {count:,} vertices", working=size)


def read_joints(count: int, attributes: Entry, accessors: Accessors) -> Vertices:
    """The joints and their weights (N, K) of `count` vertices, by the field of `Deformation`."""
    joints: list[NDArray[Any]] = []
    weights: list[NDArray[Any]] = []
    # Sets of four joints have numbers without a gap (glTF 2.0, 3.7.3.3).
    for number in range(_MOST_SETS):
        if f"JOINTS_{number}" not in attributes:
            break
        joints.append(accessors.integers(attributes.integer(f"JOINTS_{number}"), attributes, ("VEC4",)))
        weights.append(accessors.floats(attributes.integer(f"WEIGHTS_{number}"), attributes, ("VEC4",)))
        if not len(joints[-1]) == len(weights[-1]) == count:
            raise attributes.error(f"has {len(joints[-1])} joints and {len(weights[-1])} weights for {count} positions")
        if (weights[-1] < 0).any():
            raise attributes.error(f"has negative weights in WEIGHTS_{number}; export the file again")
    if not joints:
        return {}
    indices, shares = np.concatenate(joints, axis=1), np.concatenate(weights, axis=1)
    # Many files have four joints a vertex of which one or two are used.
    used = np.flatnonzero((shares > 0).any(axis=0)).tolist() or [0]
    return {"joints": indices[:, used].astype(np.uint32), "joint_weights": shares[:, used]}


def deformation_of(vertices: Vertices) -> Deformation | None:
    """The deformation of vertices with rows of `read_targets` and `read_joints`."""
    fields: dict[str, Any] = {field: vertices.get(field) for field in ("joints", "joint_weights")}
    fields |= {field: np.moveaxis(vertices[field], 1, 0) for field in TARGETS.values() if field in vertices}
    return Deformation(**fields) if any(values is not None for values in fields.values()) else None
