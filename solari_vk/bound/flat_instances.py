"""The tree over the triangles of instances that never moved, for rays by compute shaders.

Two levels of trees cost more than one tree in world space, because boxes of instances overlap, and because each
instance that a ray meets transforms the ray. Where meshes have several instances, two levels take so much less memory
that caches hold them; such meshes stay below instances. Hits are the same: scene/trace_compute.glsl.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.spatial_order import memory_order
from solari_vk.gpu.acceleration.geometry import TriangleGeometry
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.trees.tree import TAG_DTYPE, FlatTree, build_meshes
from solari_vk.scene.model import Mesh

# Of the tree, which takes 80 bytes for each.
MAX_TRIANGLES = 1 << 21
# So few triangles are all in the tree; else only meshes that have one instance.
FEW_TRIANGLES = 1 << 14
# How far from the origin an instance may reach, in sizes of its triangles: coordinates are rounded to 2^-24 of that,
# which would bend finer triangles.
MAX_REACH = 1 << 14
# The tree is built again when so large a share of what was looked at has left it, or is new.
MAX_OUTDATED = 0.5


class Placed(NamedTuple):
    """An instance as rays see it."""

    transform: tuple[float, ...]
    """World from object, 12 numbers row by row."""
    mesh: Any
    positions: int
    """The address of the mesh's vertices, which is another one when they were edited."""
    triangle_count: int
    box: tuple[NDArray[np.float32], NDArray[np.float32]]
    """The center and half the size (3,) of the mesh's bounds, in object space."""
    joins: bool
    """Whether it is visible and opaque, and its mesh doesn't move."""

    @property
    def is_suitable(self) -> bool:
        """Whether it may be in the flat tree: it is invertible, and its triangles stay what they are in world space."""
        if not self.joins or self.triangle_count == 0:
            return False
        a, b, c, x, d, e, f, y, g, h, i, z = self.transform
        volume = abs(a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g))
        center, half_size = (values.tolist() for values in self.box)
        corner = [abs(place) + half for place, half in zip(center, half_size, strict=True)]
        reach = max(
            abs(x) + abs(a) * corner[0] + abs(b) * corner[1] + abs(c) * corner[2],
            abs(y) + abs(d) * corner[0] + abs(e) * corner[1] + abs(f) * corner[2],
            abs(z) + abs(g) * corner[0] + abs(h) * corner[1] + abs(i) * corner[2],
        )
        scale: float = volume ** (1 / 3)
        triangle_size = 2 * scale * max(half_size) / math.sqrt(self.triangle_count)
        return bool(0 < reach <= MAX_REACH * triangle_size < math.inf)

    @property
    def identity(self) -> tuple[Any, ...]:
        """What is another one for an instance that has changed."""
        return self.transform, self.mesh, self.positions, self.joins


class FlatInstances:
    """Which instances, by their rows, are in the flat tree. One that has changed since it was placed never joins."""

    def __init__(self, device: Device) -> None:
        self.tree: FlatTree | None = None
        self._device = device
        self._placed: dict[int, Placed] = {}
        self._suitable: set[int] = set()  # rows that have not changed and could be in the tree
        self._slots: dict[int, int] = {}
        self._seen = 0  # triangles of the suitable instances when the tree was built
        self._new: set[int] = set()  # suitable rows that came later
        self._outdated = 0  # triangles of those, and of instances that have left the tree

    def place(self, row: int, now: Placed) -> int:
        """Set an instance; returns one more than its slot in the tree, or 0 if it isn't there."""
        before = self._placed.get(row)
        if before is None and now.is_suitable:
            self._suitable.add(row)
            self._new.add(row)
            self._outdated += now.triangle_count
        elif before is not None and before.identity != now.identity:
            self._leave(row)
        self._placed[row] = now
        return self._slots.get(row, -1) + 1

    def remove(self, row: int) -> None:
        """Forget an instance."""
        if row in self._placed:
            self._leave(row)
            del self._placed[row]

    def _leave(self, row: int) -> None:
        count = self._placed[row].triangle_count
        self._suitable.discard(row)
        if self._slots.pop(row, None) is not None:
            self._outdated += count
        elif row in self._new:
            self._new.remove(row)
            self._outdated -= count

    @property
    def slots(self) -> dict[int, int]:
        """The slots of the rows that are in the tree."""
        return self._slots

    @property
    def is_outdated(self) -> bool:
        """Whether the tree should be built again."""
        return self._outdated > MAX_OUTDATED * self._seen

    def build(self, orders: Any) -> None:
        """Build another tree over the instances; the earlier one is the caller's to free. orders: of the triangles of
        each mesh, as they are on the device."""
        rows = self._choose()
        tree = None
        if rows:
            corners, tags = self._triangles(rows, orders)
            order = memory_order(self._device.properties.kind, corners.min(axis=1), corners.max(axis=1))
            tree = self._build(corners[order], tags[order], len(rows))
        self.tree = tree
        self._slots = {row: slot for slot, row in enumerate(rows)}
        self._seen = sum(self._placed[row].triangle_count for row in self._suitable)
        self._new.clear()
        self._outdated = 0

    def _choose(self) -> list[int]:
        """The rows of the instances that fit into the tree."""
        rows = sorted(self._suitable)
        users = Counter(self._placed[row].mesh for row in rows)
        few = sum(self._placed[row].triangle_count for row in rows) <= FEW_TRIANGLES
        chosen = set()
        room = MAX_TRIANGLES
        for mesh, count in users.items():
            size = count * len(mesh.triangles)
            if (few or count == 1) and size <= room:
                chosen.add(mesh)
                room -= size
        return [row for row in rows if self._placed[row].mesh in chosen]

    def _triangles(self, rows: list[int], orders: Any) -> tuple[NDArray[np.float32], NDArray[Any]]:
        """The corners of the instances' triangles in world space (N, 3, 3), and their tags (N,)."""
        slots_of: dict[Mesh, list[int]] = {}
        for slot, row in enumerate(rows):
            slots_of.setdefault(self._placed[row].mesh, []).append(slot)
        corners = []
        tags = []
        for mesh, slots in slots_of.items():
            transforms = np.array([self._placed[rows[slot]].transform for slot in slots]).reshape(-1, 3, 4)
            points = mesh.positions[mesh.triangles[orders[mesh]]].astype(np.float64)
            placed = np.einsum("nij,tcj->ntci", transforms[:, :, :3], points) + transforms[:, None, None, :, 3]
            of_mesh = np.zeros((len(slots), len(points)), TAG_DTYPE)
            of_mesh["number"] = np.arange(len(points))
            of_mesh["slot"] = np.array(slots)[:, None]
            with np.errstate(over="ignore"):  # no ray hits what is infinite
                corners.append(placed.reshape(-1, 3, 3).astype(np.float32))
            tags.append(of_mesh.ravel())
        return np.concatenate(corners), np.concatenate(tags)

    def _build(self, corners: NDArray[np.float32], tags: NDArray[Any], instance_count: int) -> FlatTree:
        count = len(corners)
        arrays = corners, np.arange(3 * count, dtype=np.uint32), tags
        with self._device.undone_on_error():
            buffers = [self._device.buffer(array.nbytes, "static triangles") for array in arrays]
            for buffer, array in zip(buffers, arrays, strict=True):
                buffer.upload(array)
            positions, indices, of_tags = (buffer.address for buffer in buffers)
            geometry = TriangleGeometry(positions, 3 * count, count, indices)
            tree = FlatTree(self._device, geometry, of_tags, instance_count)
            build_meshes(self._device, [tree])
        for buffer in buffers:
            buffer.destroy()
        return tree

    def destroy(self) -> None:
        """Free the tree."""
        if self.tree is not None:
            self.tree.destroy()
