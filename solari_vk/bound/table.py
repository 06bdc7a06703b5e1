"""Tables: records that the host edits and a device buffer mirrors; and the assignment of rows to objects."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import full_barrier
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.uploads import Uploads
from solari_vk.gpu.frame.uniforms import packing

Key = TypeVar("Key", bound=Hashable)
_MOST_INLINE = 1 << 16  # bytes that vkCmdUpdateBuffer takes at most
# Makes a Table or a HostTable of a name, a dtype and, for `set`, its fields.
MakeTable = Callable[..., Any]


class HostTable:
    """Records of one dtype in the host's memory.

    fields: the names of all fields, in the order in which `set` takes their numbers; only `set` needs them. Raises
    SolariError if the dtype has other fields or another order.
    """

    def __init__(self, name: str, dtype: np.dtype[Any], fields: Sequence[str] | None = None) -> None:
        names = dtype.names or ()
        if fields is not None:
            if tuple(fields) != names:
                raise SolariError(f"the shaders' {name} have the fields {', '.join(names)}, not {', '.join(fields)}")
            self._packing, _ = packing(dtype, names)
        self._size = dtype.itemsize
        self.name = name
        self.revision = 0
        """Increases when rows are written, so that readers see changes; of tables on the host alone."""
        self._set_records(np.zeros(16, dtype))

    def _set_records(self, records: NDArray[Any]) -> None:
        self.records = records
        self._bytes = records.view(np.uint8).data

    def set(self, row: int, *numbers: float) -> None:
        """Write a row: the numbers of all its fields in order; fields with several numbers take them one by one."""
        self._packing.pack_into(self._bytes, row * self._size, *numbers)
        self.revision += 1

    def reserve(self, rows: int) -> None:
        """Make room for `rows` rows."""
        # Twice as many rows as before, so that n rows added one by one are copied less than 2 n times.
        if rows > len(self.records):
            grown = np.zeros(max(rows, self._doubled()), self.records.dtype)
            grown[: len(self.records)] = self.records
            self._set_records(grown)
            self.mark_all()

    def _doubled(self) -> int:
        return 2 * len(self.records)

    def mark(self, rows: Iterable[int]) -> None:
        """Tell the table which rows of `records` were written."""
        self.revision += 1

    def mark_all(self) -> None:
        """Mark all rows, so that they are uploaded again."""
        self.revision += 1

    def destroy(self) -> None:
        """Free what is on the device."""


class Table(HostTable):
    """Records of one dtype, on the host in `records` and on the device in `buffer`."""

    def __init__(self, device: Device, name: str, dtype: np.dtype[Any], fields: Sequence[str] | None = None) -> None:
        self._device = device
        super().__init__(name, dtype, fields)
        self.buffer = self._make_buffer()
        self.marked: set[int] = set(range(len(self.records)))
        """The rows whose latest contents are not in `buffer` yet."""

    def _set_records(self, records: NDArray[Any]) -> None:
        super()._set_records(records)
        self._pointer = raw.ffi.cast("char*", raw.ffi.from_buffer(records))

    def _make_buffer(self) -> Buffer:
        buffer = self._device.buffer(self.records.nbytes, self.name)
        self._mapped = buffer.view().data if buffer.mapped else None
        return buffer

    def _doubled(self) -> int:
        # Doubling ends at the largest buffer that a shader can access.
        return min(super()._doubled(), int(self._device.properties.limits.maxStorageBufferRange) // self._size)

    def set(self, row: int, *numbers: float) -> None:
        self._packing.pack_into(self._bytes, row * self._size, *numbers)
        self.marked.add(row)

    def mark(self, rows: Iterable[int]) -> None:
        self.marked.update(rows)

    def mark_all(self) -> None:
        self.marked.update(range(len(self.records)))

    def replace(self) -> bool:
        """Replace the buffer by a larger one if the records no longer fit; returns whether it was replaced."""
        if self.records.nbytes <= self.buffer.size:
            return False
        self.buffer.destroy()
        self.buffer = self._make_buffer()
        return True

    def write(self) -> bool:
        """Write the marked rows directly, which needs an idle device; returns False if the memory isn't mapped."""
        if self._mapped is None:
            return False
        for begin, end in self._runs():
            self._mapped[begin:end] = self._bytes[begin:end]
        self.marked.clear()
        return True

    def record(self, cmd: raw.CData) -> None:
        """Record writes of the marked rows, whose contents become part of the commands."""
        update = self._device.vk.vkCmdUpdateBuffer
        for begin, end in self._runs():
            update(cmd, self.buffer.handle, begin, end - begin, self._pointer + begin)
        self.marked.clear()

    def upload(self, uploads: Uploads) -> None:
        """Upload the marked rows after all work submitted so far."""
        for begin, end in self._runs():
            uploads.buffer(self.buffer, self._bytes[begin:end], begin)
        self.marked.clear()

    @property
    def marked_bytes(self) -> int:
        """The size of the marked rows."""
        return len(self.marked) * self._size

    def _runs(self) -> list[tuple[int, int]]:
        """The byte ranges (begin, end) of the marked rows; adjacent rows share a range."""
        size = self._size
        first = min(self.marked)
        last = max(self.marked)
        if last - first + 1 == len(self.marked):  # one range, the usual case
            return [(first * size, (last + 1) * size)]
        rows = np.fromiter(self.marked, np.int64, len(self.marked))
        rows.sort()
        runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
        return [(int(run[0]) * size, (int(run[-1]) + 1) * size) for run in runs]

    def destroy(self) -> None:
        self.buffer.destroy()


def upload_tables(device: Device, tables: Sequence[Table]) -> None:
    """Upload the marked rows of tables that have some, before the next submission."""
    # While no work in progress reads the tables, the host may write where the device reads.
    if device.idle:
        tables = [table for table in tables if not table.write()]
    # Large changes go through staging memory, small ones into the commands themselves.
    if sum(table.marked_bytes for table in tables) > _MOST_INLINE:
        with device.uploads() as uploads:
            for table in tables:
                table.upload(uploads)
    elif tables:

        def record(cmd: raw.CData) -> None:
            # Frames that are in flight must have read the rows before they are overwritten.
            device.vk.vkCmdPipelineBarrier2(cmd, full_barrier())
            for table in tables:
                table.record(cmd)
            device.vk.vkCmdPipelineBarrier2(cmd, full_barrier())

        device.start_with_next(record, "edits of the scene")


class RowAllocator(dict[Key, int]):
    """Assigns a row to each object in use: from its first user until its last user releases it."""

    def __init__(self) -> None:
        super().__init__()
        # The number of uses of an object by each user: an instance may have a mesh as its mesh and as its ray mesh.
        self._users: dict[Key, dict[Hashable, int]] = {}
        self._free: list[int] = []
        self.high_water_mark = 0
        """One more than the highest row ever used."""

    def users(self, key: Key) -> list[Any]:
        """The users of an object."""
        return list(self._users.get(key, ()))

    def acquire(self, key: Key, user: Hashable) -> bool:
        """Add a use of an object; returns whether the object got a new row."""
        users = self._users.setdefault(key, {})
        users[user] = users.get(user, 0) + 1
        if key in self:
            return False
        if self._free:
            self[key] = self._free.pop()
        else:
            self[key] = self.high_water_mark
            self.high_water_mark += 1
        return True

    def release(self, key: Key, user: Hashable) -> bool:
        """Remove a use of an object; returns whether it was the last use, which frees the row."""
        users = self._users[key]
        users[user] -= 1
        if users[user] == 0:
            del users[user]
        if users:
            return False
        del self._users[key]
        self._free.append(self.pop(key))
        return True


def content_of(*arrays: NDArray[Any] | None) -> bytes:
    """A digest of the shapes, types and numbers of arrays, with None for those that there are not."""
    found = hashlib.sha256()
    for array in arrays:
        found.update(b"-" if array is None else f"{array.dtype.str}{array.shape}".encode())
        if array is not None:
            found.update(np.ascontiguousarray(array).data.cast("B") if array.size else b"")
    return found.digest()
