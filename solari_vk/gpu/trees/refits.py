"""Refits of trees over meshes that move, by glsl/scene/trees/refit.comp, and new builds of those that became bad.

The device finds out how bad a tree is. The host learns it two updates of the scene later, when frames have waited for
that work anyhow: so equal runs build trees in equal frames.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

from solari_vk.base.errors import DeviceError
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import host_read_barrier
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.trees.tree import MeshTree, Topology, build_meshes, parts_of, record_parts, tree_kernel

SLOTS = 1024  # of a tree, for each workgroup
# A tree is built anew when its cost has grown by this factor since it was built.
MAX_GROWTH = 1.5
LATENCY = 2  # updates until the growth is read
REFIT_DTYPE = np.dtype(
    [(name, "<u8") for name in ("corners", "indices", "source", "fitted")] + [("slot_count", "<u4"), ("growth", "<f4")]
)
"""TreeRefit of refit.comp."""


class TreeRefits:
    """Refits of trees. pairs: trees, and those from which their nodes are taken: built ones of the same meshes."""

    def __init__(self, device: Device, pairs: Sequence[tuple[MeshTree, MeshTree]]) -> None:
        self._device = device
        self._pairs = pairs
        rows = []
        for tree, source in pairs:
            geometry = tree.geometry
            addresses = geometry.positions, geometry.indices, source.address, tree.address
            rows.append((*addresses, tree.slot_count, 0))
        records = np.array(rows, REFIT_DTYPE)
        slots = records["slot_count"].astype(np.int64)
        parts = parts_of(np.arange(len(pairs)), -(-slots // SLOTS))
        self._part_count = len(parts)
        with device.undone_on_error():
            self._kernel = tree_kernel(device, "refit")
            self._buffer = device.buffer(max(records.nbytes + parts.nbytes, 16), "refits of trees", host=True)
        self._buffer.write(records)
        self._buffer.write(parts, records.nbytes)
        self.topologies: list[Topology] = []
        """Those of the trees, after `record`."""

    def record(self, commands: raw.CData) -> None:
        """Record the refits, after all earlier and before all later work."""
        refits = self._buffer.address
        parts = refits + REFIT_DTYPE.itemsize * len(self._pairs)
        record_parts(self._device, commands, self._kernel, self._part_count, parts, refits=refits, slots=SLOTS)
        self._device.vk.vkCmdPipelineBarrier2(commands, host_read_barrier())
        for tree, source in self._pairs:
            tree.built = True
            tree.topology = source.topology
            tree.topology.newest = tree
        self.topologies = [tree.topology for tree, _ in self._pairs]

    def growths(self) -> np.ndarray:
        """By what factors the costs have grown since the trees were built, once the work is done."""
        return self._buffer.view(REFIT_DTYPE, len(self._pairs))["growth"].copy()

    def destroy(self) -> None:
        """Free the records when the work submitted so far is done."""
        self._buffer.destroy()


class MovedTrees:
    """The trees of a scene that are refitted. Call `improve` at the end of each update."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._updates = 0  # with work between them: a frame may ask for several
        self._submitted = -1
        self._bad: dict[Topology, None] = {}
        # The update of refits, and the value of the timeline when they are done.
        self._waiting: deque[tuple[int, int, TreeRefits]] = deque()

    def record(self, commands: raw.CData, pairs: Sequence[tuple[MeshTree, MeshTree]]) -> None:
        """Record refits, for the next submission: `TreeRefits`."""
        refits = TreeRefits(self._device, pairs)
        refits.record(commands)
        self._waiting.append((self._updates, self._device.submitted + 1, refits))

    def submit(self, pairs: Sequence[tuple[MeshTree, MeshTree]]) -> None:
        """Have refits run just before the next submission."""
        if pairs:
            self._device.start_with_next(lambda commands: self.record(commands, pairs), "refit trees")

    def improve(self) -> None:
        """Build those trees anew that have become too bad, as they are now."""
        if self._device.submitted == self._submitted:
            return
        self._submitted = self._device.submitted
        self._updates += 1
        while self._waiting:
            update, done, refits = self._waiting[0]
            if update + LATENCY > self._updates or done > self._device.submitted:
                break
            self._waiting.popleft()
            self._device.await_value(done)
            for topology, growth in zip(refits.topologies, refits.growths(), strict=True):
                if growth > MAX_GROWTH:
                    self._bad[topology] = None
            refits.destroy()
        # A tree that was built since has another topology.
        bad = [one.newest for one in self._bad if one.newest.topology is one and not one.newest.destroyed]
        self._bad = {tree.topology: None for tree in bad}
        if not bad:
            return
        try:
            build_meshes(self._device, bad, moved=True)
        except DeviceError:
            if self._device.lost or self._device.closed:
                raise
            return  # rays are right as they are, and the next update tries it again
        self._bad = {}

    def destroy(self) -> None:
        """Free the records of refits."""
        for _, _, refits in self._waiting:
            refits.destroy()
