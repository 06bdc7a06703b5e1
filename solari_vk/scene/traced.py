"""The instances as rays meet them: the TLAS and the records it is built from, in spatial order."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from solari_vk.gpu.acceleration.tlas import INSTANCE_DTYPE, Tlas, TlasBuild
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.device import Device
from solari_vk.scene.spatial import spatial_order
from solari_vk.scene.table import Table

VISIBLE = 0xFF << 24  # the mask of instances that all rays meet
NO_CULLING = raw.VK_GEOMETRY_INSTANCE_TRIANGLE_FACING_CULL_DISABLE_BIT_KHR << 24
# What `write` writes, in this order.
RECORD = ("transform", "custom_index_and_mask", "sbt_offset_and_flags", "blas_address")
FEW = 64  # instances whose order matters little


class TracedInstances:
    """Records by place in the TLAS, which follows space; the instance's row is the custom index.

    Places are chosen anew when instances come or go, and when half of them, and more than a few, have
    moved since.
    """

    def __init__(self, device: Device) -> None:
        self.tlas = Tlas(device, 16, name="scene")
        self.table = Table(device, "tlas_instances", INSTANCE_DTYPE, RECORD)
        self.count = 0
        self._device = device
        self._places: dict[int, int] = {}  # of each row
        self._middles: dict[int, NDArray[np.float32]] = {}  # of each row, in object space
        self._end = 0  # of the places given, those of removed rows among them
        self._sorted = True
        self._moved = 0
        self._rebuild = True
        self._build: TlasBuild | None = None

    def write(
        self, row: int, transform: Sequence[float], middle: NDArray[np.float32], visible: bool, double_sided: bool,
        address: int,
    ) -> None:  # fmt: skip
        """Set a row: world from object (12 numbers, row by row), the mesh's middle (3,), and its BLAS's address."""
        place = self._places.get(row)
        if place is None:
            place = self._places[row] = self._end
            self._end += 1
            self.table.reserve(self._end)
            self._sorted = False
        self._middles[row] = middle
        self._moved += 1
        # Vulkan's default front is glTF's, counter-clockwise in object space, however instances are mirrored.
        self.table.set(place, *transform, row | VISIBLE if visible else row, NO_CULLING if double_sided else 0, address)

    def remove(self, row: int) -> None:
        """Forget a row."""
        self._places.pop(row, None)
        self._middles.pop(row, None)
        self._sorted = False

    def _centers(self, rows: NDArray[np.int64]) -> NDArray[np.float64]:
        """In the world (N, 3)."""
        transforms = self.table.records["transform"][[self._places[row] for row in rows.tolist()]].astype(np.float64)
        middles = np.array([self._middles[row] for row in rows.tolist()])
        centers: NDArray[np.float64] = np.einsum("nij,nj->ni", transforms[:, :, :3], middles) + transforms[:, :, 3]
        return centers

    def _rows(self) -> NDArray[np.int64]:
        return np.fromiter(self._places, np.int64, len(self._places))

    def lit_area(self) -> float:
        """Of a disk around the instances' centres, square metres; at least 1."""
        if not self._places:
            return 1.0
        return max(float(np.square(np.ptp(self._centers(self._rows()), axis=0)).sum()) * np.pi / 4, 1.0)

    def update(self) -> bool:
        """Put everything in its place; True when the TLAS is another one than before."""
        if not self._sorted or self._moved > max(self.count // 2, FEW):
            self._sort()
        self._rebuild |= bool(self.table.marked)
        if self.count <= self.tlas.max_instances:
            return False
        self.tlas.destroy()
        self.tlas = Tlas(self._device, max(self.count, 2 * self.tlas.max_instances), name="scene")
        return True

    def _sort(self) -> None:
        rows = np.sort(self._rows())
        if len(rows):
            rows = rows[spatial_order(self._centers(rows))]
        self.count = self._end = len(rows)
        self.table.records[: self.count] = self.table.records[[self._places[row] for row in rows.tolist()]]
        self.table.mark(range(self.count))
        self._places = {row: place for place, row in enumerate(rows.tolist())}
        self._sorted, self._moved = True, 0
        self._rebuild = True

    def mark_all(self) -> None:
        """Have everything uploaded and built again."""
        self.table.mark_all()
        self._rebuild = True

    def rebuild(self) -> None:
        """If records changed, have the TLAS built anew, behind their upload."""
        if not self._rebuild:
            return
        needed = self.tlas, self.table.buffer.address, self.count
        if self._build is None or self._build.made_for != needed:
            old, self._build = self._build, TlasBuild(*needed)
            if old is not None:
                old.destroy()
        self._build.submit()
        self._rebuild = False

    def destroy(self) -> None:
        """Free everything."""
        if self._build is not None:
            self._build.destroy()
        self.table.destroy()
        self.tlas.destroy()
