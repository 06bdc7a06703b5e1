"""Rows of records that the host edits and a device buffer mirrors, and who uses which row."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from solari_vk.errors import SolariError
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.uploads import Uploads
from solari_vk.gpu.frame.packing import packing

Key = TypeVar("Key", bound=Hashable)


class Table:
    """Records of one dtype, on the host in `records` and, once written or uploaded, in `buffer`.

    fields: all fields in the order in which `set` is given their numbers. Raises SolariError unless it is the dtype's.
    """

    def __init__(self, device: Device, name: str, dtype: np.dtype[Any], fields: Sequence[str] | None = None) -> None:
        self.name = name
        self._device = device
        names = dtype.names or ()
        if fields is not None and tuple(fields) != names:
            raise SolariError(f"the shaders' {name} have the fields {', '.join(names)}, not {', '.join(fields)}")
        self._packing, _ = packing(dtype, names)
        self._size = dtype.itemsize
        self._keep(np.zeros(16, dtype))
        self.buffer = self._make_buffer()
        self.marked: set[int] = set(range(len(self.records)))
        """Rows that `buffer` doesn't hold yet."""

    def _keep(self, records: NDArray[Any]) -> None:
        self.records = records
        self._bytes = records.view(np.uint8).data

    def _make_buffer(self) -> Buffer:
        buffer = self._device.buffer(self.records.nbytes, self.name)
        self._mapped = buffer.view().data if buffer.mapped else None
        return buffer

    def reserve(self, rows: int) -> None:
        """Have room for rows 0 to rows - 1."""
        if rows > len(self.records):
            # Doubling stops where a shader can't see more.
            most = self._device.properties.limits.maxStorageBufferRange // self.records.itemsize
            grown = np.zeros(max(rows, min(2 * len(self.records), most)), self.records.dtype)
            grown[: len(self.records)] = self.records
            self._keep(grown)
            self.mark_all()

    def set(self, row: int, *numbers: float) -> None:
        """Write a row: the numbers of all its fields, in their order, those of several numbers one by one."""
        self._packing.pack_into(self._bytes, row * self._size, *numbers)
        self.marked.add(row)

    def mark(self, rows: Iterable[int]) -> None:
        """Say which rows of `records` were written."""
        self.marked.update(rows)

    def mark_all(self) -> None:
        """Have everything uploaded again."""
        self.marked.update(range(len(self.records)))

    def replace(self) -> bool:
        """Make a larger buffer if the records have outgrown it; True then."""
        if self.records.nbytes <= self.buffer.size:
            return False
        self.buffer.destroy()
        self.buffer = self._make_buffer()
        return True

    def write(self) -> bool:
        """Write the marked rows at once, on an idle device; False when its memory isn't mapped."""
        if self._mapped is None:
            return False
        for begin, end in self._runs():
            self._mapped[begin:end] = self._bytes[begin:end]
        self.marked.clear()
        return True

    def upload(self, uploads: Uploads) -> None:
        """Upload the marked rows, behind all work submitted so far."""
        for begin, end in self._runs():
            uploads.buffer(self.buffer, self._bytes[begin:end], begin)
        self.marked.clear()

    def _runs(self) -> list[tuple[int, int]]:
        """Where marked rows that follow each other begin and end, in bytes."""
        size, first, last = self._size, min(self.marked), max(self.marked)
        if last - first + 1 == len(self.marked):  # one run, as of a single row: most frames
            return [(first * size, (last + 1) * size)]
        rows = np.fromiter(self.marked, np.int64, len(self.marked))
        rows.sort()
        runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
        return [(int(run[0]) * size, (int(run[-1]) + 1) * size) for run in runs]

    def destroy(self) -> None:
        """Free the device buffer."""
        self.buffer.destroy()


class Rows(dict[Key, int]):
    """A row number for each object that somebody uses: taken with its first user, freed with its last."""

    def __init__(self) -> None:
        super().__init__()
        self._users: dict[Key, dict[Hashable, int]] = {}
        self._free: list[int] = []
        self.limit = 0
        """One past the highest row ever used."""

    def users(self, key: Key) -> list[Any]:
        """Who uses the object."""
        return list(self._users.get(key, ()))

    def acquire(self, key: Key, user: Hashable) -> bool:
        """Count one more use; True when the object is new here."""
        users = self._users.setdefault(key, {})
        users[user] = users.get(user, 0) + 1
        if key in self:
            return False
        if self._free:
            self[key] = self._free.pop()
        else:
            self[key] = self.limit
            self.limit += 1
        return True

    def release(self, key: Key, user: Hashable) -> bool:
        """Count one use less; True when that was the last and the row is free again."""
        users = self._users[key]
        users[user] -= 1
        if users[user] == 0:
            del users[user]
        if users:
            return False
        del self._users[key]
        self._free.append(self.pop(key))
        return True
