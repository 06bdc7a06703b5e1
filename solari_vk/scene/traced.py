"""The instances as rays meet them: the TLAS and the records it is built from, in spatial order."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from solari_vk.gpu import raw
from solari_vk.gpu.acceleration import INSTANCE_DTYPE, Tlas
from solari_vk.gpu.device import Device
from solari_vk.scene.spatial import spatial_order
from solari_vk.scene.table import Table

ALWAYS = 0xFF  # mask of visible instances
FEW = 64  # instances whose order matters little


class TracedInstances:
    """Records by instance row. The row is the custom index; the place in the TLAS follows space.

    Places are chosen anew when instances come or go, and when half of them, and more than a few, have
    moved since.
    """

    def __init__(self, device: Device) -> None:
        self.tlas = Tlas(device, 16, name="scene")
        self.table = Table(device, "tlas_instances", INSTANCE_DTYPE)
        self.count = 0
        self._device = device
        self._records = np.zeros(0, INSTANCE_DTYPE)
        self._centers = np.zeros((0, 3), np.float32)
        self._active = np.zeros(0, bool)
        self._places = np.zeros(0, np.int64)
        self._sorted = True
        self._moved = 0
        self._changed: list[NDArray[np.int64]] = []
        self._rebuild = True

    def write(
        self,
        rows: NDArray[np.int64],
        transforms: NDArray[np.float32],
        centers: NDArray[np.float32],
        visible: NDArray[np.bool_],
        double_sided: NDArray[np.bool_],
        addresses: NDArray[np.uint64],
    ) -> None:
        """Set rows: world from object (N, 3, 4), world-space centres (N, 3), and the BLAS's addresses."""
        self._reserve(int(rows.max()) + 1)
        self._sorted &= bool(self._active[rows].all())
        self._active[rows] = True
        self._centers[rows] = centers
        records = np.zeros(len(rows), INSTANCE_DTYPE)
        records["transform"] = transforms
        records["custom_index_and_mask"] = rows.astype(np.uint32) | np.where(visible, ALWAYS << 24, 0).astype(np.uint32)
        # Vulkan's default front is glTF's, counter-clockwise in object space, however instances are mirrored.
        cull_disable = raw.VK_GEOMETRY_INSTANCE_TRIANGLE_FACING_CULL_DISABLE_BIT_KHR
        records["sbt_offset_and_flags"] = np.where(double_sided, cull_disable << 24, 0)
        records["blas_address"] = addresses
        self._records[rows] = records
        self._changed.append(rows)
        self._moved += len(rows)

    def remove(self, row: int) -> None:
        """Forget a row."""
        self._active[row] = False
        self._sorted = False

    def _reserve(self, rows: int) -> None:
        if rows > len(self._records):
            more = max(rows, 2 * len(self._records)) - len(self._records)
            self._records = np.concatenate([self._records, np.zeros(more, INSTANCE_DTYPE)])
            self._centers = np.concatenate([self._centers, np.zeros((more, 3), np.float32)])
            self._active = np.concatenate([self._active, np.zeros(more, bool)])
            self._places = np.concatenate([self._places, np.zeros(more, np.int64)])

    def lit_area(self) -> float:
        """Of a disk around the instances' centres, square metres; at least 1."""
        if not self._active.any():
            return 1.0
        centers = self._centers[self._active].astype(np.float64)
        return max(float(np.square(np.ptp(centers, axis=0)).sum()) * np.pi / 4, 1.0)

    def update(self) -> bool:
        """Bring `table.records` up to date; True when the TLAS is another one than before."""
        if self._sorted and self._moved <= max(self.count // 2, FEW):
            for rows in self._changed:
                rows = rows[self._active[rows]]
                self.table.records[self._places[rows]] = self._records[rows]
                self.table.mark(self._places[rows].tolist())
        else:
            rows = np.flatnonzero(self._active)
            rows = rows[spatial_order(self._centers[rows])]
            self.count = len(rows)
            self._places[rows] = np.arange(self.count)
            self.table.reserve(self.count)
            self.table.records[: self.count] = self._records[rows]
            self.table.mark(range(self.count))
            self._sorted, self._moved = True, 0
            self._rebuild = True
        self._changed.clear()
        self._rebuild |= self.table.dirty
        if self.count <= self.tlas.max_instances:
            return False
        self.tlas.destroy()
        self.tlas = Tlas(self._device, max(self.count, 2 * self.tlas.max_instances), name="scene")
        return True

    def mark_all(self) -> None:
        """Have everything uploaded and built again."""
        self.table.mark_all()
        self._rebuild = True

    def rebuild(self) -> None:
        """If records changed, have the TLAS rebuilt just before the next submission, behind their upload."""
        if self._rebuild:
            self._rebuild = False
            self._device.before_next_submit(self._build)

    def _build(self, commands: raw.CData) -> None:
        if not self.tlas.destroyed:  # the binder may have gone before anything was submitted
            self.tlas.record_build(commands, self.table.buffer.address, self.count)

    def destroy(self) -> None:
        """Free everything."""
        self.table.destroy()
        self.tlas.destroy()
