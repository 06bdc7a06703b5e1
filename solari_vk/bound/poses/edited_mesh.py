"""A mesh whose positions were edited, as the device has it: those of earlier revisions are kept for motion vectors."""

from __future__ import annotations

from collections.abc import Iterable

from solari_vk.gpu.device.buffer import Buffer


class EditedMesh:
    """The positions of a mesh at revisions of the scene, on a row of the table of meshes.

    address: of the current positions, which are those since `revision`.
    """

    def __init__(self, row: int, address: int) -> None:
        self.row = row
        self.address = address
        self.revision = 0
        self._earlier: dict[int, Buffer] = {}  # which begin with the positions, by their first revision

    def edit(self, buffer: Buffer, address: int, revision: int) -> None:
        """Take note of other positions from a revision on. buffer: of the current ones, is owned from now on."""
        self._earlier[self.revision] = buffer
        self.address, self.revision = address, revision

    def address_at(self, revision: float) -> int | None:
        """The address of the positions at a revision, None if they aren't known."""
        known = {first: buffer.address for first, buffer in self._earlier.items()} | {self.revision: self.address}
        return known.get(max((first for first in known if first <= revision), default=-1))

    def keep(self, seen: Iterable[int]) -> None:
        """Free the positions that were current at none of some revisions."""
        needed = {self.address_at(revision) for revision in seen}
        for first, buffer in list(self._earlier.items()):
            if buffer.address not in needed:
                buffer.destroy()
                del self._earlier[first]

    def destroy(self) -> None:
        """Free all earlier positions."""
        self.keep(())
