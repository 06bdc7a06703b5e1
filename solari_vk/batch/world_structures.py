"""The top-level acceleration structures of a batch's worlds, and the buffer from which shaders take the world's own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.gpu.acceleration.tlas import INSTANCE_DTYPE
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.structures import SceneStructure, scene_builds, scene_structure


class WorldStructures:
    """A top-level structure for each world, all built in one step from one buffer of records."""

    def __init__(self, device: Device, count: int) -> None:
        self.addresses: Buffer = device.buffer(16 * count, "world_structures")
        """Of each world the address of its structure, and of that of the previous frame."""
        self.records: Buffer | None = None
        """What the structures are built from: the records of each world's instances (worlds, N)."""
        self._device = device
        self._count = count
        self._shown: list[int] = []  # what `addresses` holds
        self._structures: Sequence[SceneStructure] = ()
        self._builds: Any = None
        self._built: tuple[int, Sequence[int], Any] = (0, (), None)  # N, the counts and the flat tree of `_builds`

    def set_addresses(self, addresses: list[int]) -> None:
        """Have shaders traverse the structures at these addresses, two for each world."""
        if addresses != self._shown:
            self._shown = addresses
            self.addresses.upload(np.array(addresses, np.uint64))

    def prepare(self, records: NDArray[Any], counts: Sequence[int], flat_tree: Any) -> None:
        """Upload the records (worlds, N) that `build` builds from. counts: how many of them each world has. flat_tree:
        that of the scene, if it has one."""
        buffer = uploaded(self._device, self.records, records, "tlas_instances")
        # A build that is prepared once can be submitted in each frame.
        wanted = records.shape[1], counts, flat_tree
        if buffer is not self.records or self._builds is None or self._built != wanted:
            self.records = buffer
            self._built = wanted
            self._make_builds(buffer, *wanted)

    def build(self) -> None:
        """Have the next submission build all structures. Worlds keep no structure of the previous frame: shaders that
        ask for it get the current one."""
        assert self._builds is not None
        self._builds.submit()
        self.set_addresses([structure.address for structure in self._structures for _ in ("now", "previous")])

    def _make_builds(self, records: Buffer, stride: int, counts: Sequence[int], flat_tree: Any) -> None:
        if self._builds is not None:
            self._builds.destroy()
            self._builds = None
        before: Sequence[SceneStructure | None] = self._structures or [None] * self._count
        with self._device.undone_on_error():
            slots = 0 if flat_tree is None else flat_tree.instance_count
            room = [max(count, slots) for count in counts]
            after = [self._structure(*each) for each in zip(before, range(self._count), room, strict=True)]
        for old, new in zip(before, after, strict=True):
            if old is not None and old is not new:
                old.destroy()
        self._structures = after
        self._builds = scene_builds(after, records.address, stride, counts, flat_tree)

    def _structure(self, before: SceneStructure | None, world: int, count: int) -> SceneStructure:
        """The structure that a world has, or a new one where that is too small, or much too large."""
        # Room for twice as many instances, so that a world which loses and gains some keeps its structure.
        if before is not None and count <= before.max_instances <= 2 * count + 16:
            return before
        return scene_structure(self._device, count, f"world {world}")

    def destroy(self) -> None:
        for owned in (self._builds, *self._structures, self.addresses, self.records):
            if owned is not None:
                owned.destroy()


def uploaded(device: Device, buffer: Buffer | None, records: NDArray[Any], name: str) -> Buffer:
    """Upload records to a buffer, or to a new one of their size in its place; returns that which has them."""
    # Not empty, because Vulkan has no buffers of size 0.
    size = max(records.nbytes, INSTANCE_DTYPE.itemsize)
    with device.undone_on_error():
        target = buffer if buffer is not None and buffer.size == size else device.buffer(size, name)
        if records.nbytes:
            target.upload(records)
    if buffer is not None and buffer is not target:
        buffer.destroy()
    return target
