"""The worlds of a batch: one scene many times, each with transforms, materials and lights of its own."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.batch.world_changes import Known
from solari_vk.batch.world_lights import LightsOfWorlds
from solari_vk.batch.world_objects import WorldLights, WorldMaterials, WorldTransforms
from solari_vk.batch.world_tables import WorldTables
from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.lights.bodies import has_body, transform_of
from solari_vk.bound.traced_instances import flags_of, mask_of
from solari_vk.gpu.acceleration.tlas import INSTANCE_DTYPE
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.tensors.imports import DeviceTensor
from solari_vk.gpu.tensors.port import POSE_RULE, Dispatch, rule
from solari_vk.scene.model import Instance, Material

ROW_MASK = (1 << 24) - 1  # of custom_index_and_mask


class Differing(NamedTuple):
    """What an instance has of its own in each world (worlds, ...), None for what the scene has: its transforms, the
    rows of its materials, and the flags and masks of what rays hit."""

    transforms: NDArray[np.float64] | DeviceTensor | None = None
    materials: NDArray[np.uint32] | None = None
    flags: NDArray[np.uint32] | None = None
    masks: NDArray[np.uint32] | None = None


def _same(before: Mapping[Instance, NDArray[Any]], after: Mapping[Instance, NDArray[Any]]) -> bool:
    return before.keys() == after.keys() and all(np.array_equal(rows, after[lamp]) for lamp, rows in before.items())


class Worlds(WorldTables):
    """The worlds of a batch of one scene."""

    def __init__(self, device: Device, binder: SceneBinder, count: int) -> None:
        super().__init__(device, count)
        self.transforms = WorldTransforms(binder, count)
        self.materials = WorldMaterials(binder, count)
        self.lights = WorldLights(binder, count)
        self._lit = LightsOfWorlds(device, binder, count)
        self._binder = binder
        self._seen = -1  # the `record_revision` of the scene that was written
        self._shared: dict[str, Buffer] = {}  # the scene's tables of lights, while all worlds have them
        self._surfaces: dict[Instance, Differing] = {}  # of `materials`
        self._blended: dict[Instance, tuple[Any, ...]] = {}  # in some world by `materials`, with what they looked like
        self._kept: tuple[Any, NDArray[Any], NDArray[Any]] | None = None  # what it is good for, and what was written

    @property
    def resources(self) -> Mapping[str, Any]:
        return self._shared | self._buffers

    @property
    def rows(self) -> int:
        return self._binder.instance_capacity

    @property
    def blended_changes(self) -> NDArray[np.int64]:
        return np.array([self._binder.blended_changes])

    @property
    def known_lights(self) -> list[Known] | None:
        return self._lit.known if self._lit.tables else None

    @property
    def lit(self) -> bool:
        """Whether some world has lights of its own, or materials without shading."""
        own = [material for given in self.materials.present().values() for material in given]
        return any(len(known.ids) for known in self.known_lights or ()) or any(material.unlit for material in own)

    def update(self) -> int:
        if self.count == 1:
            tlas = self._binder.tlas
            assert tlas is not None
            self._show_addresses([tlas.current.address, (tlas.previous or tlas.current).address])
            return self.version
        own = self.transforms, self.materials, self.lights
        edited = self._seen != self._binder.records.record_revision
        if edited or any(given.changed for given in own):
            self._seen = -1  # until all is written
            for given in own:
                given.present()
            if edited or self.materials.changed:
                self._note_materials()
            self._binder.records.blended_changes += any(map(self._is_blended, self.transforms.changed))
            lit = self.lights.changed or self.materials.changed or any(map(self._is_lamp, self.transforms.changed))
            lamp_rows = self._lit.lamp_rows
            if edited or lit:
                lamp_rows = {lamp: rows.copy() for lamp, rows in lamp_rows.items()}
                self._lit.update(self.lights, self.materials, self.transforms, self.rows)
                for name, table in self._lit.tables.items():
                    self._upload(name, table)
            bodies = self._bodies()
            if (
                edited
                or bodies
                or self.transforms.changed
                or self.materials.changed
                or not _same(lamp_rows, self._lit.lamp_rows)
            ):
                self._write(self._differing(bodies), moved_only=not (edited or lit or bodies))
            self._seen = self._binder.records.record_revision
            for given in own:
                given.changed.clear()
        self._share_lights()
        return self.version

    def _is_lamp(self, instance: Instance) -> bool:
        return self._binder.lights.index(instance) is not None or instance in self._lit.lamp_rows

    def _is_blended(self, instance: Instance) -> bool:
        return instance in self._blended or (instance not in self._surfaces and instance.alpha_mode == "blend")

    def _share_lights(self) -> None:
        """Have `resources` name the scene's tables of lights, unless the worlds have some of their own."""
        shared = {table.name: table.buffer for table in self._binder.lights.tables}
        if self._lit.tables:
            shared = {}
        else:
            for name in shared.keys() & self._buffers.keys():
                self._buffers.pop(name).destroy()
        if shared != self._shared:
            self._shared = shared
            self.version += 1

    # ---- what differs between worlds ----------------------------------------------------------------

    def _note_materials(self) -> None:
        """Take note of the materials of instances, which must be in the binder's tables."""
        self._surfaces, built_anew = {}, False
        blended: dict[Instance, tuple[Any, ...]] = {}
        for instance, given in self.materials.present().items():
            found: dict[Material, tuple[int, int, int]] = {}
            for material in dict.fromkeys(given):
                variant = copy.copy(instance)
                variant.update(material=material)
                if (mode := variant.alpha_mode) != "opaque":
                    self._binder.add_feature(variant)
                if mode == "blend":
                    blended[instance] = instance.transform.tobytes(), instance.visible, instance.mesh, *given
                    built_anew |= self._binder.use_single_hits(instance.ray_mesh or instance.mesh)
                flags = flags_of(material.double_sided, mode)
                found[material] = self._binder.materials.rows[material], flags, mask_of(instance.visible, mode)
            rows, flags, masks = np.array([found[material] for material in given], np.uint32).T
            self._surfaces[instance] = Differing(None, rows, flags, masks)
        self._binder.records.blended_changes += blended != self._blended
        self._blended = blended
        if built_anew:
            self._binder.update()

    def _bodies(self) -> dict[Instance, Differing]:
        """The bodies of lights that cast shadows."""
        found = {}
        for light, given in self.lights.present().items():
            body = self._binder.lights.bodies.of(light)
            if body is None:
                wrong = [world for world, one in enumerate(given) if has_body(one)]
                if wrong:
                    raise SolariError(
                        f"Batch.world_lights: {light.describe()} blocks light in world {wrong[0]}, for "
                        "which it needs a body in the scene: set blocks_light there too"
                    )
                continue
            casts = [has_body(one) for one in given]
            places = [transform_of(one) if has_body(one) else body.transform for one in given]
            masks = np.array([mask_of(cast, "opaque") for cast in casts], np.uint32)
            found[body] = Differing(np.stack(places), None, None, masks)
        return found

    def _differing(self, bodies: Mapping[Instance, Differing]) -> dict[Instance, Differing]:
        differing = {**self._surfaces, **bodies}
        for instance, transforms in self.transforms.present().items():
            differing[instance] = differing.get(instance, Differing())._replace(transforms=transforms)
        return differing

    # ---- instances and their structures -------------------------------------------------------------

    def _write(self, differing: Mapping[Instance, Differing], *, moved_only: bool) -> None:
        binder, traced, worlds = self._binder.records, self._binder.records.traced, self.count
        lamp_rows = self._lit.lamp_rows
        given = [(instance, own.transforms is None, own.materials is None) for instance, own in differing.items()]
        kept = binder.record_revision, (*given,), (*lamp_rows,)
        on_device = [instance for instance, own in differing.items() if isinstance(own.transforms, DeviceTensor)]
        changed = self.transforms.changed
        if moved_only and self._kept is not None and self._kept[0] == kept and changed.issubset(on_device):
            self._place(differing, [instance for instance in on_device if instance in changed])
            return
        if self._kept is None or self._kept[0] != kept:
            self._check_room(binder.scene.describe(), binder.instance_table.records.dtype.itemsize)
            records = np.tile(binder.instance_table.records, (worlds, 1))
            instances = np.tile(traced.table.records[: traced.count], (worlds, 1))
            instances["custom_index_and_mask"] += (np.arange(worlds, dtype=np.uint32) * self.rows)[:, None]
            self._kept = kept, records, instances
        _, records, instances = self._kept
        for instance, own in differing.items():
            row = binder.instance_rows[instance]
            place = traced.place(row)
            if own.transforms is not None and not isinstance(own.transforms, DeviceTensor):
                records["world_from_object"][:, row] = own.transforms[:, :3].transpose(0, 2, 1)
                instances["transform"][:, place] = own.transforms[:, :3]
            if own.materials is not None:
                records["material"][:, row] = own.materials
                instances["sbt_offset_and_flags"][:, place] = own.flags
            if own.masks is not None:
                index = instances["custom_index_and_mask"][:, place] & ROW_MASK
                instances["custom_index_and_mask"][:, place] = index | own.masks
        for lamp, rows in lamp_rows.items():
            records["light_index"][:, binder.instance_rows[lamp]] = rows
        self._upload("instances", records)
        self._prepare(instances, (traced.count,) * worlds)
        self._place(differing, on_device)

    def _place(self, differing: Mapping[Instance, Differing], on_device: Iterable[Instance]) -> None:
        """Build the structures, with the transforms that tensors give of some instances written on the device."""
        binder, traced = self._binder.records, self._binder.records.traced
        records = binder.instance_table.records
        fields = records.dtype.fields
        assert self._records is not None
        assert fields is not None
        size, begin = records.dtype.itemsize // 4, fields["world_from_object"][1] // 4
        for instance in on_device:
            tensor = differing[instance].transforms
            assert isinstance(tensor, DeviceTensor)
            row = binder.instance_rows[instance]
            ray_size = INSTANCE_DTYPE.itemsize // 4
            # In floats. The shaders' records and those that rays are traced in have the transform in different order.
            places = {
                "first": self._buffers["instances"].address,
                "first_place": row * size + begin,
                "first_step": self.rows * size,
                "second": self._records.address,
                "second_place": traced.place(row) * ray_size,
                "second_step": traced.count * ray_size,
            }
            port = self._binder.tensors
            name = instance.describe()
            subject = f"Batch.transforms: {name}"
            pushed = {
                **port.matrices(tensor, self.count),
                **port.refusal(subject, rule(subject, "world", POSE_RULE)),
                **places,
            }
            port.write([Dispatch("transforms", (self.count, 1), pushed)], name, with_next=True)
        self._build()

    def destroy(self) -> None:
        self.materials.destroy()
        self._lit.destroy()
        super().destroy()
