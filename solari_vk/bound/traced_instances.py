"""The instances as rays see them: records in spatial order, and the TLAS that is built from them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.constants import BLENDED_MASK, SCENE_MASK
from solari_vk.bound.flat_instances import FlatInstances, Placed
from solari_vk.bound.spatial_order import memory_order
from solari_vk.bound.table import MakeTable
from solari_vk.gpu.acceleration.tlas import INSTANCE_DTYPE
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.structures import (
    SceneStructure,
    build_mesh_structures,
    scene_build,
    scene_copy,
    scene_structure,
    traces_by_compute,
)
from solari_vk.gpu.trees.tree import FlatTree, SceneBuild

# The bits of custom_index_and_mask above the index. HIDDEN isn't 0, because Mesa 26.2 loses other instances where a
# mask is 0 (docs/driver_faults.md).
VISIBLE = (SCENE_MASK & ~BLENDED_MASK) << 24
BLENDED = SCENE_MASK << 24
HIDDEN = 0x80 << 24
NO_OPAQUE = raw.VK_GEOMETRY_INSTANCE_FORCE_NO_OPAQUE_BIT_KHR << 24
NO_CULLING = raw.VK_GEOMETRY_INSTANCE_TRIANGLE_FACING_CULL_DISABLE_BIT_KHR << 24
# The bits of sbt_offset_and_flags below the flags: one more than the slot of an instance in the flat tree, or 0.
SLOT_MASK = np.uint32((1 << 24) - 1)
# The fields that `write` sets, in order.
RECORD = ("transform", "custom_index_and_mask", "sbt_offset_and_flags", "blas_address")
# So many updates without a change improve a tree over instances; later ones would gain little.
IMPROVEMENTS = 24
# So few written records need no new order.
FEW_MOVES = 64
# The center and half the size (3,) of a mesh's bounds, in object space.
Box = tuple[NDArray[np.float32], NDArray[np.float32]]


def mask_of(visible: bool, alpha_mode: str) -> int:
    """The bits of custom_index_and_mask above the index, of an instance with a material of this mode."""
    if not visible:
        return HIDDEN
    return BLENDED if alpha_mode == "blend" else VISIBLE


def flags_of(hides_back: bool, alpha_mode: str) -> int:
    """sbt_offset_and_flags of such an instance."""
    return (0 if hides_back else NO_CULLING) | (0 if alpha_mode == "opaque" else NO_OPAQUE)


class TracedRecords:
    """The records of a TLAS in spatial order; an instance's custom index is its row in the table of instances.

    The order is computed again when instances were added or removed, and when records were written more often since the
    last sorting than half their number, and more than FEW_MOVES times. An instance that moves twice counts twice.
    """

    def __init__(self, table: MakeTable, device_kind: str) -> None:
        self.table = table("tlas_instances", INSTANCE_DTYPE, RECORD)
        self.count = 0
        self._device_kind = device_kind
        self.flat: FlatInstances | None = None
        """Which of the instances are in one tree, where rays are traced by compute."""
        self._indices: dict[int, int] = {}  # index of the record of each row
        self._mesh_boxes: dict[int, Box] = {}
        # Where some instances are in one tree: of each row the structure of its mesh, which may not be built yet, the
        # rows for which that was not looked at, and those that worlds of a batch have elsewhere.
        self._structures: dict[int, Any] = {}
        self._unchecked: set[int] = set()
        self._moved_by_worlds: set[int] = set()
        self._end = 0  # number of records, including those of removed rows
        self._sorted = True
        self._moved = 0  # records that were written since the last sorting

    def write(
        self,
        row: int,
        transform: Sequence[float],
        box: Box,
        visible: bool,
        hides_back: bool,
        alpha_mode: str,
        mesh: Any,
        structure: Any,
    ) -> None:
        """Set a row: world from object (12 numbers, row by row), the mesh's bounds, the mesh in its pose, and its
        structure."""
        index = self._indices.get(row)
        if index is None:
            index = self._indices[row] = self._end
            self._end += 1
            self.table.reserve(self._end)
            self._sorted = False
        self._mesh_boxes[row] = box
        self._moved += 1
        # By default Vulkan's front faces are glTF's: counter-clockwise in object space, for mirrored instances too.
        flags = flags_of(hides_back, alpha_mode)
        if self.flat is not None:
            geometry = structure.geometry
            joins = visible and alpha_mode == "opaque" and not structure.moves
            placed = Placed(tuple(transform), mesh, geometry.positions, geometry.triangle_count, box, joins)
            flags |= self.flat.place(row, placed)
            self._structures[row] = structure
            self._unchecked.add(row)
        self.table.set(index, *transform, row | mask_of(visible, alpha_mode), flags, structure.address)

    def remove(self, row: int) -> None:
        """Remove a row."""
        self._indices.pop(row, None)
        self._mesh_boxes.pop(row, None)
        self._sorted = False
        if self.flat is not None:
            self.flat.remove(row)
            self._structures.pop(row, None)
            self._unchecked.discard(row)
            self._moved_by_worlds.discard(row)

    def record_index(self, row: int) -> int:
        """The index of a row's record in `table`."""
        return self._indices[row]

    def _boxes(self, rows: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The centers and half the sizes, both (N, 3), of the bounds of instances in world space."""
        transforms = self.table.records["transform"][[self._indices[row] for row in rows.tolist()]].astype(np.float64)
        boxes = np.array([self._mesh_boxes[row] for row in rows.tolist()])
        # The box around a turned box: Arvo, "Transforming Axis-Aligned Bounding Boxes" (1990).
        turns = transforms[:, :, :3]
        centers = np.einsum("nij,nj->ni", turns, boxes[:, 0]) + transforms[:, :, 3]
        return centers, np.einsum("nij,nj->ni", np.abs(turns), boxes[:, 1])

    def _rows(self) -> NDArray[np.int64]:
        return np.fromiter(self._indices, np.int64, len(self._indices))

    def lit_area(self) -> float:
        """The area of a disk around the instances, in square meters; at least 1."""
        # Rather too large than too small: lamps keep half of the samples on the wide ground of a room beside a sun, but
        # a sun over a scene of one mesh that counted as a point would have few.
        if not self._indices:
            return 1.0
        centers, half_sizes = self._boxes(self._rows())
        extent = (centers + half_sizes).max(axis=0) - (centers - half_sizes).min(axis=0)
        return max(float(np.square(extent).sum()) * np.pi / 4, 1.0)

    def sort(self) -> bool:
        """Restore the spatial order; returns whether that was needed."""
        if self._sorted and self._moved <= max(self.count // 2, FEW_MOVES):
            return False
        # By rows first, so that the order doesn't depend on the order of edits.
        rows = np.sort(self._rows())
        if len(rows):
            centers, half_sizes = self._boxes(rows)
            rows = rows[memory_order(self._device_kind, centers - half_sizes, centers + half_sizes)]
        self.count = self._end = len(rows)
        self.table.records[: self.count] = self.table.records[[self._indices[row] for row in rows.tolist()]]
        self.table.mark(range(self.count))
        self._indices = {row: index for index, row in enumerate(rows.tolist())}
        self._sorted = True
        self._moved = 0
        return True

    def write_slots(self) -> None:
        """Write where all instances are in the flat tree."""
        assert self.flat is not None
        flags = self.table.records["sbt_offset_and_flags"]
        flags &= ~SLOT_MASK
        for row, slot in self.flat.slots.items():
            flags[self._indices[row]] |= slot + 1
        self.table.mark(range(self.count))
        self._unchecked.update(self._structures)

    # ---- trees of meshes beside the flat tree --------------------------------------------------------

    def _needs_own_tree(self, row: int) -> bool:
        assert self.flat is not None
        return row not in self.flat.slots or row in self._moved_by_worlds

    def build_trees(self, device: Device) -> None:
        """Build the trees that instances outside the flat tree need, and write their addresses."""
        rows = [row for row in self._unchecked if self._needs_own_tree(row)]
        structures = dict.fromkeys(self._structures[row] for row in sorted(rows))
        build_mesh_structures(device, [one for one in structures if not (one.built or one.moves)])
        for row in rows:
            index, address = self._indices[row], self._structures[row].address
            if self.table.records["blas_address"][index] != address:
                self.table.records["blas_address"][index] = address
                self.table.mark([index])
        self._unchecked.clear()

    def take_unused_trees(self) -> list[Buffer]:
        """The memory of trees of meshes that have instances in the flat tree alone, which is the caller's to free."""
        needed = {structure for row, structure in self._structures.items() if self._needs_own_tree(row)}
        unused = dict.fromkeys(one for one in self._structures.values() if one.built and one not in needed)
        return [tree.take_memory() for tree in unused]

    def use_own_tree(self, device: Device, row: int) -> int:
        """Have a tree of its own for the mesh of an instance that worlds of a batch have elsewhere; returns its
        address."""
        if self.flat is not None:
            self._moved_by_worlds.add(row)
            self._unchecked.add(row)
            self.build_trees(device)
        return int(self.table.records["blas_address"][self._indices[row]])


class SceneTlas:
    """The top-level acceleration structure over a scene's records, and a copy of it for motion through past frames.

    orders: of the triangles of each mesh, as they are on the device.
    """

    def __init__(self, device: Device, traced: TracedRecords, orders: Mapping[Any, Any]) -> None:
        self.current = scene_structure(device, 16, "scene")
        self.previous: SceneStructure | None = None
        """The structure as it was in the previous frame, while it is kept."""
        self._device = device
        self._traced = traced
        self._rebuild = True
        self._build: Any = None
        self._improvements = 0  # steps that the tree of the latest build is still improved by
        self._built_for: tuple[Any, ...] | None = None  # what `_build` writes and reads
        self._copy: Any = None
        self._previous_differs = False
        self._addresses: Buffer | None = None  # of both, for shaders that traverse trees
        self._shown: tuple[int, ...] = ()  # what `_addresses` holds
        self._orders = orders
        # Trees that `current` had before its next build, and those of `previous` that `current` hasn't any more.
        self._replaced: list[FlatTree | Buffer] = []
        self._of_previous: list[FlatTree | Buffer] = []
        if traces_by_compute(device):
            traced.flat = FlatInstances(device)
            self._addresses = device.buffer(16, "world_structures")

    @property
    def resources(self) -> dict[str, Any]:
        """What shaders bind, by names in glsl/scene/trace.glsl."""
        structures = self.current, self.previous or self.current
        if self._addresses is None:
            return dict(zip(("tlas", "previous_tlas"), structures, strict=True))
        addresses = tuple(structure.address for structure in structures)
        if addresses != self._shown:
            self._addresses.upload(np.array(addresses, np.uint64))
            self._shown = addresses
        return {"world_structures": self._addresses}

    @property
    def flat_tree(self) -> FlatTree | None:
        """The tree over instances that never moved, if there is one."""
        return None if self._traced.flat is None else self._traced.flat.tree

    def keep_previous(self, needed: bool) -> bool:
        """Keep the structure of the previous frame from now on, or free it; returns whether `previous` is another."""
        if needed == (self.previous is not None):
            return False
        if self.previous is not None:
            self.previous.destroy()
            self.previous = None
        else:
            self.previous = scene_structure(self._device, self.current.max_instances, "previous scene")
            self._previous_differs = self.current.built
        return True

    def make_room(self) -> bool:
        """Sort the records if needed; returns whether the structure was replaced by a larger one."""
        self._rebuild |= self._traced.sort() or bool(self._traced.table.marked)
        flat = self._traced.flat
        if flat is not None and flat.is_outdated:
            replaced = self.flat_tree
            flat.build(self._orders)
            if replaced is not None:
                self._replaced.append(replaced)
            self._traced.write_slots()
            self._replaced += self._traced.take_unused_trees()
            self._rebuild = True
        if flat is not None:
            self._traced.build_trees(self._device)
        count = self._traced.count
        if count <= self.current.max_instances:
            return False
        larger = scene_structure(self._device, max(count, 2 * self.current.max_instances), "scene")
        self.current.destroy()
        self.current = larger
        if self.previous is not None:
            self.previous.destroy()
            self.previous = None
            self.keep_previous(True)
        return True

    def mark_all(self) -> None:
        """Have the next `rebuild` build the structure, whatever has changed."""
        self._rebuild = True

    def rebuild(self, meshes_alive: bool = True) -> None:
        """If records changed, submit a build after their upload. Call it once in each frame.

        meshes_alive: no structure of a mesh was destroyed since the last call. Otherwise rays can't be traced through
        the structure of the previous frame, and this frame's takes its place.
        """
        changed = self._rebuild
        self._rebuild = False
        keeps = changed and meshes_alive and self.previous is not None and self.previous.built
        if keeps:
            self._copy_to_previous()  # before the build overwrites it
        if changed:
            self._submit_build()
            self._improvements = IMPROVEMENTS
        elif self._improvements and isinstance(self._build, SceneBuild):
            self._build.improve()
            self._improvements -= 1
        # In the first frame without changes both are the same again.
        if changed or self._previous_differs:
            if not keeps:
                self._copy_to_previous()
            self._previous_differs = keeps
            self._free_replaced(keeps)

    def _free_replaced(self, keeps: bool) -> None:
        """Free trees that neither structure has any more. keeps: `previous` is `current` before its latest build."""
        outdated = self._of_previous if keeps else self._of_previous + self._replaced
        for tree in outdated:
            tree.destroy()
        self._of_previous = self._replaced if keeps else []
        self._replaced = []

    def _copy_to_previous(self) -> None:
        if self.previous is None:
            return
        needed = self.current, self.previous
        if self._copy is None or self._copy.made_for != needed:
            old = self._copy
            self._copy = scene_copy(*needed)
            if old is not None:
                old.destroy()
        self._copy.submit()

    def _submit_build(self) -> None:
        # A build is prepared once, and submitted again as long as it reads and writes the same memory. A buffer may
        # have the address of one that is gone.
        buffer = self._traced.table.buffer
        needed = self.current, buffer, self._traced.count, self.flat_tree
        if self._build is None or self._built_for != needed:
            old = self._build
            self._build = scene_build(self.current, buffer.address, self._traced.count, self.flat_tree)
            self._built_for = needed
            if old is not None:
                old.destroy()
        self._build.submit()

    def destroy(self) -> None:
        owned = self._build, self._copy, self.previous, self.current, self._addresses
        for made in (*owned, self.flat_tree, *self._replaced, *self._of_previous):
            if made is not None:
                made.destroy()
