"""What the worlds of a batch have on the device: rows of `instances`, a top-level structure each, and lights.

A world's rows of `instances` follow those of the world before. Each world has a top-level structure, whose instances
have these rows as their custom indices, so that shaders which have a hit need not know its world.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.batch.view_table import ViewTable
from solari_vk.batch.world_changes import Known
from solari_vk.bound.scene_records import MAX_INSTANCES
from solari_vk.gpu.acceleration.tlas import INSTANCE_DTYPE, Tlas, TlasBuilds
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device


class WorldTables:
    """The tables and structures of a batch's worlds: `resources` for frames over them, beside the scene's."""

    shows_scenes = False
    """Whether each world has a scene of its own."""

    def __init__(self, device: Device, count: int) -> None:
        self.count = count
        self.version = 0  # of `resources`: frames bind them again when it has changed
        self._device = device
        self._addresses: list[int] = []
        self._buffers: dict[str, Buffer] = {"world_structures": device.buffer(16 * count, "world_structures")}
        self._records: Buffer | None = None
        self._structures: Sequence[Tlas] = ()
        self._builds: TlasBuilds | None = None
        self._built: tuple[int, Sequence[int]] = (0, ())

    @property
    def resources(self) -> Mapping[str, Any]:
        """Buffers by their names in GLSL."""
        return self._buffers

    @property
    def rows(self) -> int:
        """The number of rows of a world in `instances`."""
        raise NotImplementedError

    @property
    def lit(self) -> bool:
        """Whether something may shine in a world that its scene doesn't have."""
        return False

    @property
    def known_lights(self) -> list[Known] | None:
        """What is known of the lights of each world; None where all have the scene's."""
        raise NotImplementedError

    @property
    def blended_changes(self) -> NDArray[np.int64]:
        """The number of changes of blended instances so far, of each world (W,) or of all (1,)."""
        raise NotImplementedError

    def update(self) -> int:
        """Have the next submission show the worlds as they are, and their scenes, whose edits are applied; returns
        `version`. Raises SolariError for more worlds than the device holds, and for what worlds can't have."""
        raise NotImplementedError

    @property
    def numbers(self) -> tuple[int, ...]:
        """What `number` writes depends on."""
        return self.rows, int(self.known_lights is not None)

    def number(self, table: ViewTable) -> None:
        """Write to the records of views which world each shows: as many views to each, one after the other."""
        table.shared["has_own_lights"] = self.known_lights is not None
        records = table.records
        records["world"] = np.arange(len(records)) // (len(records) // self.count)
        records["first_instance"] = records["world"] * self.rows

    def _check_room(self, of: str, row_bytes: int) -> None:
        limit = self._device.properties.limits.maxStorageBufferRange
        most = min(MAX_INSTANCES // self.rows, limit // (self.rows * row_bytes))
        if self.count > most:
            raise SolariError(
                f"Batch: {self.count:,} worlds of {of}, with {self.rows:,} rows of "
                f"instances each: this device holds at most {most:,}: share the worlds among several "
                "batches"
            )

    def _upload(self, name: str, records: NDArray[Any]) -> None:
        before = self._buffers.get(name)
        self._buffers[name] = self._uploaded(before, records, name)
        self.version += self._buffers[name] is not before

    def _uploaded(self, buffer: Buffer | None, records: NDArray[Any], name: str) -> Buffer:
        size = max(records.nbytes, INSTANCE_DTYPE.itemsize)
        with self._device.undone_on_error():
            uploaded = buffer if buffer is not None and buffer.size == size else self._device.buffer(size, name)
            if records.nbytes:
                uploaded.upload(records)
        if buffer is not None and buffer is not uploaded:
            buffer.destroy()
        return uploaded

    def _prepare(self, records: NDArray[Any], counts: Sequence[int]) -> None:
        """Have structures for records (W, N), of which worlds have the first of these counts."""
        rays = self._uploaded(self._records, records, "tlas_instances")
        wanted = records.shape[1], counts
        if rays is not self._records or self._builds is None or self._built != wanted:
            self._records, self._built = rays, wanted
            self._make_structures(records.shape[1], counts)

    def _build(self) -> None:
        assert self._builds is not None
        self._builds.submit()
        self._show_addresses([structure.address for structure in self._structures for _ in ("now", "previous")])

    def _make_structures(self, stride: int, counts: Sequence[int]) -> None:
        """Make those that are too small, and have all built."""
        assert self._records is not None
        if self._builds is not None:
            self._builds.destroy()
            self._builds = None
        before: Sequence[Tlas | None] = self._structures or [None] * self.count
        with self._device.undone_on_error():
            after = [
                one
                if one is not None and count <= one.max_instances <= 2 * count + 16
                else Tlas(self._device, count, name=f"world {world}")
                for world, (count, one) in enumerate(zip(counts, before, strict=True))
            ]
        for old, new in zip(before, after, strict=True):
            if old is not None and old is not new:
                old.destroy()
        self._structures = after
        self._builds = TlasBuilds(self._structures, self._records.address, stride, counts)

    def _show_addresses(self, addresses: list[int]) -> None:
        if addresses != self._addresses:
            self._addresses = addresses
            self._buffers["world_structures"].upload(np.array(addresses, np.uint64))

    def _free_structures(self) -> None:
        if self._builds is not None:
            self._builds.destroy()
        for structure in self._structures:
            structure.destroy()
        self._builds, self._structures = None, ()

    def destroy(self) -> None:
        """Free everything."""
        self._free_structures()
        for buffer in (*self._buffers.values(), self._records):
            if buffer is not None:
                buffer.destroy()
