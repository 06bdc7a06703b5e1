"""What the device has of a mesh that moves: in the pose of an instance, or with positions that were edited."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.gpu.device import raw
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.trees.tree import MeshTree
from solari_vk.scene.meshes.deformation import Deformation
from solari_vk.scene.objects import Instance, Mesh

# A BLAS is built anew after so many refits, each of which leaves its tree as it was grouped, and when the surface area
# of the bounds has changed by this factor since the last build.
MAX_REFITS = 32
MAX_GROWTH = 1.5

Pose = tuple[NDArray[np.float64] | None, NDArray[np.float64] | None]


class PosedMesh:
    """A mesh in the pose of an instance."""

    def __init__(self, mesh: Mesh, instance: Instance) -> None:
        self.mesh = mesh
        self.instance = instance
        self.pose: Pose = (None, None)
        """What its vertices are to show."""
        self.side = 0
        """Which of the two positions and BLASes show the newest pose."""
        self.revisions = [-1, -1]
        """The revisions of the scene from which on the two poses are current; -1 for none."""
        self.copies: dict[int, Buffer] = {}
        """Positions of earlier poses by their revisions."""
        self.buffer: Buffer | None = None
        self.addresses = (0, 0, 0)  # two of positions, and of attributes
        self.blases: list[Any] = []
        self.refits = 0
        self.built_area = 0.0
        self.area = 0.0
        self.work: dict[tuple[int, ...], Any] = {}
        """Records of work for `PoseCommands`, by what they depend on."""
        self.build_infos: dict[tuple[int, bool], raw.CData] = {}
        """What the device is told of builds, by side and whether they are refits."""

    @property
    def deformation(self) -> Deformation:
        """The deformation of its mesh."""
        assert self.mesh.deformation is not None
        return self.mesh.deformation

    @property
    def rebuilds(self) -> bool:
        """Whether its BLAS should be built rather than refitted. Of trees `MovedTrees` decides."""
        if isinstance(self.blases[self.side], MeshTree):
            return not self.blases[1 - self.side].built
        growth = self.area / self.built_area if self.built_area > 0 else 2 * MAX_GROWTH
        return self.refits >= MAX_REFITS or not 1 / MAX_GROWTH <= growth <= MAX_GROWTH

    @property
    def revision(self) -> int:
        """The revision of the scene from which on the newest pose is current."""
        return self.revisions[self.side]

    @property
    def address(self) -> int:
        """The address of the positions in the newest pose."""
        return self.addresses[self.side]

    def revision_at(self, revision: float) -> int:
        """The revision of the latest known pose that is not newer than a revision; -1 if there is none."""
        poses = (*self.revisions, *self.copies)
        return max((pose for pose in poses if pose <= revision), default=-1)

    def address_at(self, revision: float) -> int | None:
        """The address of the positions at a revision, None if they aren't known."""
        found = self.revision_at(revision)
        if found in self.copies:
            return self.copies[found].address
        return self.addresses[self.revisions.index(found)] if found >= 0 else None

    def destroy(self) -> None:
        """Free its memory; it can be made again."""
        for owned in (self.buffer, *self.blases, *self.copies.values()):
            if owned is not None:
                owned.destroy()
        self.buffer = None
        self.blases = []
        self.built_area = 0.0
        self.copies = {}
        self.work = {}
        self.build_infos = {}

    def build_info(self, scratch: int, *, update: bool) -> raw.CData:
        """What the device is told of a build of the current side, or of its refit from the other one."""
        info = self.build_infos.get((self.side, update))
        if info is None:
            info = self.blases[self.side].build_info(update=update, source=self.blases[1 - self.side])
            self.build_infos[self.side, update] = info
        info.scratchData.deviceAddress = scratch
        return info


class EditedMesh:
    """The positions of a mesh at revisions of the scene, of which motion vectors need earlier ones. row: of the mesh in
    its table.

    address: of the current positions, which are those since `revision`.
    """

    def __init__(self, row: int, address: int) -> None:
        self.row = row
        self.address = address
        self.revision = 0
        self._earlier: dict[int, Buffer] = {}  # which begin with the positions, by their first revision

    def edit(self, buffer: Buffer, address: int, revision: int) -> None:
        """Have other positions from a revision on. buffer: of the positions so far, is owned from now on."""
        self._earlier[self.revision] = buffer
        self.address = address
        self.revision = revision

    def address_at(self, revision: float) -> int | None:
        """The address of the positions at a revision, None if they aren't known."""
        addresses = {first: buffer.address for first, buffer in self._earlier.items()}
        addresses[self.revision] = self.address
        return addresses.get(max((first for first in addresses if first <= revision), default=-1))

    def free_unseen(self, seen: Iterable[int]) -> None:
        """Free the positions that were current at none of some revisions, which frames may ask for."""
        needed = {self.address_at(revision) for revision in seen}
        for first, buffer in list(self._earlier.items()):
            if buffer.address not in needed:
                buffer.destroy()
                del self._earlier[first]

    def destroy(self) -> None:
        """Free all earlier positions."""
        self.free_unseen(())
