"""The node hierarchy of a glTF file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene.files.gltf.accessors import Accessors
from solari_vk.scene.files.gltf.document import Document
from solari_vk.scene.files.gltf.report import Report
from solari_vk.scene.files.gltf.values import Entry, shown
from solari_vk.scene.matrices import compose, quaternion_rotation

Matrix = NDArray[np.float64]
LEVELS = "MSFT_lod"
NO_QUATERNION = "rotations of length 0, which are no unit quaternions, turn nothing"
_BYTES_PER_JOINT = 1024  # of a node with a skin
_IDENTITY = tuple(np.eye(4).reshape(-1).tolist())


@dataclass(frozen=True)
class PlacedNode:
    """A node with its matrix, world from node (4, 4). parent: its parent's number, -1 for a root."""

    number: int
    parent: int
    entry: Entry
    world: Matrix
    visible: bool


def roots(document: Document, which: int | str | None) -> tuple[list[int], Entry]:
    """The root nodes of a scene by index or name (None: the file's default scene), and the object that lists them."""
    scenes = document.array("scene")
    if which is None:
        if not scenes:
            return _orphans(document), document.root
        which = document.root.integer("scene", 0)
    if isinstance(which, str):
        names = [document.item("scene", number, document.root).name for number in range(len(scenes))]
        if which not in names:
            known = ", ".join(f"'{shown(name)[1:-1]}'" for name in names[:10] if name)
            raise document.error(f"has no scene named {shown(which)}; it has {len(names)}, named {known or 'nothing'}")
        which = names.index(which)
    if not 0 <= which < len(scenes):
        raise document.error(f"has no scene {which}; it has {len(scenes)}, counted from 0")
    entry = document.item("scene", which, document.root)
    return entry.integers("nodes"), entry


def _orphans(document: Document) -> list[int]:
    """The roots of a file without scenes: all nodes without a parent."""
    count = len(document.array("node"))
    children: set[int] = set()
    for number in range(count):
        children.update(document.item("node", number, document.root).integers("children"))
    found = [number for number in range(count) if number not in children]
    if count and not found:
        raise document.error("every node is a child of another, so they form a cycle; export the file again")
    return found


@np.errstate(over="ignore", invalid="ignore")
def walk(document: Document, first: list[int], owner: Entry) -> dict[int, PlacedNode]:
    """All nodes below some roots by number, parents first, in the file's order; without coarser levels of detail."""
    coarser = _coarser_levels(document)
    placed: dict[int, PlacedNode] = {}
    identity = np.eye(4)
    # A stack, not recursion: chains of nodes may be longer than Python's limit. Reversed, so that the first comes
    # first.
    waiting: list[tuple[int, int, Matrix, bool, Entry]] = [(n, -1, identity, True, owner) for n in reversed(first)]
    while waiting:
        number, above, parent, visible, user = waiting.pop()
        if number in coarser:
            continue
        entry = document.item("node", number, user)
        if number in placed:
            raise entry.error(
                f"is reached twice, the second time from {user.place}: nodes form a tree, where each has one parent "
                "and none is below itself; export the file again"
            )
        world = parent @ local_matrix(entry)
        visible = visible and node_visibility(entry)
        placed[number] = PlacedNode(number, above, entry, world, visible)
        waiting.extend((child, number, world, visible, entry) for child in reversed(entry.integers("children")))
    return placed


def _coarser_levels(document: Document) -> set[int]:
    """The nodes that MSFT_lod shows in place of others that are far away. They need not be in the scene."""
    found: set[int] = set()
    if LEVELS in document.root.texts("extensionsUsed"):
        for number in range(len(document.array("node"))):
            levels = document.item("node", number, document.root).extension(LEVELS)
            # MSFT_lod: the node itself is the finest level, its ids are the coarser ones.
            found.update(levels.integers("ids") if levels else ())
    return found


def node_visibility(entry: Entry) -> bool:
    """Whether a node shows what hangs on it and below it, if all above it do."""
    visibility = entry.extension("KHR_node_visibility")
    return visibility is None or visibility.flag("visible", True)


def local_matrix(entry: Entry) -> Matrix:
    """The matrix from the node's space to its parent's."""
    if "matrix" in entry:
        matrix: Matrix = np.array(entry.numbers("matrix", _IDENTITY)).reshape(4, 4).T
        # The last row of an affine matrix, as far as exporters round it.
        if np.allclose(matrix[3], (0, 0, 0, 1), rtol=0, atol=1e-5):
            matrix[3] = (0, 0, 0, 1)
        return matrix
    if not ("translation" in entry or "rotation" in entry or "scale" in entry):
        return np.eye(4)
    position = entry.numbers("translation", (0.0, 0.0, 0.0))
    quaternion = entry.numbers("rotation", (0.0, 0.0, 0.0, 1.0))
    scale = entry.numbers("scale", (1.0, 1.0, 1.0))
    # Exporters round quaternions, whose length should be 1.
    length = math.hypot(*quaternion)
    x, y, z, w = (part / length for part in quaternion) if length > 0 else (0.0, 0.0, 0.0, 1.0)
    turned = quaternion_rotation(x, y, z, w)
    return np.array(
        [[*(a * b for a, b in zip(row, scale, strict=True)), x] for row, x in zip(turned, position, strict=True)]
        + [[0.0, 0.0, 0.0, 1.0]]
    )


def repetitions(node: PlacedNode, accessors: Accessors) -> tuple[int, dict[str, NDArray[Any]]]:
    """The number of instances of a node's mesh, and the accessors of EXT_mesh_gpu_instancing, if any."""
    instancing = node.entry.extension("EXT_mesh_gpu_instancing")
    attributes = instancing.entry("attributes") if instancing else None
    if attributes is None:
        return 1, {}
    found = {}
    for name, kind in (("TRANSLATION", "VEC3"), ("ROTATION", "VEC4"), ("SCALE", "VEC3")):
        index = attributes.index(name)
        if index is not None:
            found[name] = accessors.floats(index, attributes, (kind,))
    counts = {len(values) for values in found.values()} or {1}
    if len(counts) > 1:
        raise attributes.error(f"has accessors of different lengths {sorted(counts)}; export the file again")
    return counts.pop(), found


@np.errstate(over="ignore", invalid="ignore")
def repeated(node: PlacedNode, accessors: Accessors, report: Report) -> Matrix:
    """Matrices (N, 4, 4) from a node's mesh to the node: the identity, or those of EXT_mesh_gpu_instancing."""
    count, attributes = repetitions(node, accessors)
    if not attributes:
        return np.eye(4)[None]
    found = {name: values.astype(np.float64) for name, values in attributes.items()}
    if not found.get("ROTATION", np.ones((1, 4))).any(axis=1).all():
        report.add(NO_QUATERNION, node.entry.place)
    return compose(
        found.get("TRANSLATION", np.zeros((count, 3))),
        found.get("ROTATION", np.tile((0.0, 0.0, 0.0, 1.0), (count, 1))),
        found.get("SCALE", np.ones((count, 3))),
    )


def skin_of(
    document: Document, accessors: Accessors, node: PlacedNode, placed: dict[int, PlacedNode], report: Report
) -> tuple[list[int], Matrix] | None:
    """The joints of a node's skin, and matrices (J, 4, 4) from vertices to the joints in the pose of the vertices;
    None without skin or (reported) joints."""
    index = node.entry.index("skin")
    if index is None:
        return None
    skin = document.item("skin", index, node.entry)
    joints = skin.integers("joints")
    if not joints or any(joint not in placed for joint in joints):
        for joint in joints:
            # Raises for a joint that the file doesn't have at all.
            document.item("node", joint, skin)
        report.add("skins whose joints are not in the scene are left out", skin.place)
        return None
    node.entry.charge(_BYTES_PER_JOINT * len(joints), "its skin")
    inverse = skin.index("inverseBindMatrices")
    if inverse is None:
        return joints, np.tile(np.eye(4), (len(joints), 1, 1))
    bind = accessors.floats(inverse, skin, ("MAT4",))
    # More matrices than joints are allowed (glTF 2.0, 5.28.1).
    if len(bind) < len(joints):
        raise skin.error(f"has {len(bind)} inverse bind matrices for {len(joints)} joints; export the file again")
    # glTF stores matrices by columns.
    return joints, bind[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1).astype(np.float64)
