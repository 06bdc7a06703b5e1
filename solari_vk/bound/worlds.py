"""The worlds of a batch: one scene many times, each with transforms of its own for some instances.

A world's rows of `instances` follow those of the world before. Each world has a top-level structure, whose instances
have these rows as their custom indices, so that shaders which have a hit need not know its world.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, MutableMapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.bound.binder import MAX_INSTANCES, SceneBinder
from solari_vk.bound.view_table import array, check_transforms
from solari_vk.errors import SolariError, quoted
from solari_vk.gpu.acceleration.tlas import INSTANCE_DTYPE, Tlas, TlasBuilds
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.scene.model import Instance

WHERE = "Batch.transforms"


class WorldTransforms(MutableMapping[str | Instance, NDArray[np.float64]]):
    """The transforms of instances by world, by the name of each instance or by itself: (worlds, 4, 4), world from
    object. Instances without have the scene's in all worlds.

    Assign numpy arrays, or tensors. Raises SolariError for an instance that the scene doesn't have, for
    one that emits light, which all worlds share, and for transforms that `Instance.transform` doesn't take.
    """

    def __init__(self, binder: SceneBinder, worlds: int) -> None:
        self._binder, self._worlds = binder, worlds
        self._given: dict[Instance, NDArray[np.float64]] = {}
        self.changed = True

    def _instance(self, key: str | Instance) -> Instance:
        instances = self._binder.scene.instances
        if isinstance(key, Instance):
            if key not in instances:
                raise SolariError(f"{WHERE}: the scene doesn't have {key.describe()}")
            return key
        if not isinstance(key, str):
            raise SolariError(f"{WHERE}: give the name of an instance or an Instance, not {quoted(key)}")
        return instances[key]

    def __setitem__(self, key: str | Instance, transforms: ArrayLike) -> None:
        instance = self._instance(key)
        if self._worlds == 1:
            raise SolariError(f"{WHERE}: the batch has one world: assign the transform of {instance.describe()}")
        given = array(transforms, f"of {instance.describe()}", (self._worlds, 4, 4), where=WHERE)
        check_transforms(given, instance.describe(), WHERE, "world")
        self._binder.update()
        self.check_light(instance)
        self._given[instance] = np.array(given)
        self.changed = True

    def check_light(self, instance: Instance) -> None:
        """Raise SolariError for an instance that emits light."""
        if self._binder.lights.index(instance) is not None:
            raise SolariError(f"{WHERE}: {instance.describe()} emits light, and all worlds share their lights: move it "
                              "in the scene")  # fmt: skip

    def __getitem__(self, key: str | Instance) -> NDArray[np.float64]:
        """A copy."""
        instance = self._instance(key)
        return np.array(np.broadcast_to(self._given.get(instance, instance.transform), (self._worlds, 4, 4)))

    def __delitem__(self, key: str | Instance) -> None:
        """Have all worlds show an instance where the scene has it."""
        del self._given[self._instance(key)]
        self.changed = True

    def __iter__(self) -> Iterator[Instance]:
        return iter(self._given)

    def __len__(self) -> int:
        return len(self._given)

    def by_row(self) -> dict[int, NDArray[np.float64]]:
        """The transforms by the instance's row; those of instances that left the scene are forgotten."""
        rows = {instance: self._binder.instance_rows.get(instance) for instance in self._given}
        self._given = {instance: given for instance, given in self._given.items() if rows[instance] is not None}
        for instance in self._given:
            self.check_light(instance)
        return {row: self._given[instance] for instance, row in rows.items() if row is not None}


class Worlds:
    """The worlds of a batch on the device: `resources` for frames over them, beside the scene's."""

    def __init__(self, device: Device, binder: SceneBinder, count: int) -> None:
        self.count = count
        self.transforms = WorldTransforms(binder, count)
        self._device, self._binder = device, binder
        self.version = 0  # of `resources`: frames bind them again when it has changed
        self._seen: tuple[int, ...] = ()
        self._addresses: list[int] = []
        self._buffers: dict[str, Buffer] = {"world_structures": device.buffer(16 * count, "world_structures")}
        self._kept: tuple[Any, NDArray[Any], NDArray[Any]] | None = None  # what it is good for, and what was written
        self._records: Buffer | None = None
        self._structures: list[Tlas] = []
        self._builds: TlasBuilds | None = None

    @property
    def resources(self) -> Mapping[str, Any]:
        """Buffers by their names in GLSL."""
        return self._buffers

    @property
    def rows(self) -> int:
        """The number of rows of a world in `instances`."""
        return self._binder.instance_capacity

    def number(self, records: NDArray[Any]) -> None:
        """Write to the records (N,) of views which world each shows: as many views to each, one after the other."""
        if self.count > 1:
            records["world"] = np.arange(len(records)) // (len(records) // self.count)
            records["first_instance"] = records["world"] * self.rows

    def update(self) -> int:
        """Have the next submission show the scene, whose edits are applied, and the transforms as they are; returns
        `version`. Raises SolariError for more worlds than the device holds."""
        if self.count == 1:
            tlas, previous = self._binder.traced.tlas, self._binder.traced.previous
            self._show_addresses([tlas.address, (previous or tlas).address])
        elif self._seen != (self._binder.revision,) or self.transforms.changed:
            self._seen = ()  # until all is written
            self._write(self.transforms.by_row())
            self._seen, self.transforms.changed = (self._binder.revision,), False
        return self.version

    def _write(self, moved: Mapping[int, NDArray[np.float64]]) -> None:
        binder, traced, worlds = self._binder, self._binder.traced, self.count
        kept = (binder.revision, tuple(moved))
        if self._kept is None or self._kept[0] != kept:
            self._check_room()
            records = np.tile(binder.instance_table.records, (worlds, 1))
            instances = np.tile(traced.table.records[: traced.count], (worlds, 1))
            instances["custom_index_and_mask"] += (np.arange(worlds, dtype=np.uint32) * self.rows)[:, None]
            self._kept = kept, records, instances
        _, records, instances = self._kept
        for row, transforms in moved.items():
            records["world_from_object"][:, row] = transforms[:, :3].transpose(0, 2, 1)
            instances["transform"][:, traced.place(row)] = transforms[:, :3]
        before = self._buffers.get("instances")
        self._buffers["instances"] = self._uploaded(before, records, "instances")
        self.version += self._buffers["instances"] is not before
        rays = self._uploaded(self._records, instances, "tlas_instances")
        if rays is not self._records or self._builds is None or self._structures[0].max_instances != traced.count:
            self._records = rays
            self._rebuild(traced.count)
        assert self._builds is not None
        self._builds.submit()
        self._show_addresses([structure.address for structure in self._structures for _ in ("now", "previous")])

    def _check_room(self) -> None:
        binder, limit = self._binder, self._device.properties.limits.maxStorageBufferRange
        most = min(MAX_INSTANCES // self.rows, limit // (self.rows * binder.instance_table.records.dtype.itemsize))
        if self.count > most:
            raise SolariError(f"Batch: {self.count:,} worlds of {binder.scene.describe()}, with {self.rows:,} rows of "
                              f"instances each: this device holds at most {most:,}: share the worlds among several "
                              "batches")  # fmt: skip

    def _uploaded(self, buffer: Buffer | None, records: NDArray[Any], name: str) -> Buffer:
        size = max(records.nbytes, INSTANCE_DTYPE.itemsize)
        if buffer is None or buffer.size != size:
            if buffer is not None:
                buffer.destroy()
            buffer = self._device.buffer(size, name)
        if records.nbytes:
            buffer.upload(records)
        return buffer

    def _rebuild(self, count: int) -> None:
        assert self._records is not None
        self._free_structures()
        self._structures = [Tlas(self._device, count, name=f"world {index}") for index in range(self.count)]
        self._builds = TlasBuilds(self._structures, self._records.address, count)

    def _show_addresses(self, addresses: list[int]) -> None:
        if addresses != self._addresses:
            self._addresses = addresses
            self._buffers["world_structures"].upload(np.array(addresses, np.uint64))

    def _free_structures(self) -> None:
        if self._builds is not None:
            self._builds.destroy()
        for structure in self._structures:
            structure.destroy()
        self._builds, self._structures = None, []

    def destroy(self) -> None:
        """Free everything."""
        self._free_structures()
        for buffer in (*self._buffers.values(), self._records):
            if buffer is not None:
                buffer.destroy()
