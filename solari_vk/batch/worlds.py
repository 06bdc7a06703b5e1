"""What the worlds of a batch have on the device: rows of `instances`, a top-level structure each, and lights.

Worlds show one scene, in which each may have transforms, materials and lights of its own; or each shows a scene of a
list. A world's rows of `instances` follow those of the world before. Its top-level structure has instances with these
rows as their custom indices, so that shaders which have a hit need not know its world.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.batch.light_changes import LightState
from solari_vk.batch.overridden_instances import InstanceOverride, OverriddenInstances
from solari_vk.batch.overrides import LightOverrides, MaterialOverrides, TransformOverrides, WorldOverrides
from solari_vk.batch.view_buffer import ViewBuffer
from solari_vk.batch.world_lights import SharedList, WorldLightLists, WorldLights, lists_of_scenes
from solari_vk.batch.world_structures import WorldStructures, uploaded
from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.scene_records import MAX_INSTANCES, SceneRecords
from solari_vk.bound.traced_instances import SLOT_MASK
from solari_vk.gpu.acceleration.tlas import INSTANCE_DTYPE
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.tensors.imports import DeviceTensor
from solari_vk.gpu.tensors.port import POSE_RULE, Dispatch, TensorPort, rule
from solari_vk.scene.model import Instance

ROW_MASK = (1 << 24) - 1  # of custom_index_and_mask


class Worlds:
    """The worlds of a binder's scene or scenes: `resources` for frames over them, beside the binder's own. count: of
    worlds, for one scene. port: of the batch, which writes its tensors."""

    def __init__(self, device: Device, binder: SceneBinder, count: int, port: TensorPort) -> None:
        self.count = count
        self.port = port
        self.bindings_version = 0  # of `resources`: frames bind them again when it has changed
        self.overrides = None if binder.has_many_scenes else WorldOverrides(binder, count)
        """None where each world shows a scene of its own."""
        self._device = device
        self._binder = binder
        self.has_tables = count > 1 or binder.has_many_scenes
        """Whether the worlds have records of their own. One world of one scene is the scene as the binder has it."""
        self._lights = WorldLights(device, binder.lights, count)
        self._world_light_lists = WorldLightLists(device, binder, count)
        self._overridden_instances = OverriddenInstances(binder)
        self._scene_lights: Mapping[Any, SharedList] = {}  # of several scenes
        self._structures = WorldStructures(device, count)
        self._buffers: dict[str, Buffer] = {}
        self._shared: dict[str, Buffer] = {}  # the scene's tables of lights, while all worlds have them
        # A scene may stand in a list several times; one scene is that of all worlds.
        scenes = binder.listed_records if binder.has_many_scenes else binder.listed_records * count
        worlds_of: dict[SceneRecords, list[int]] = {}
        for world, records in enumerate(scenes):
            worlds_of.setdefault(records, []).append(world)
        self._worlds_of = {records: np.array(worlds) for records, worlds in worlds_of.items()}
        # What the device has, in the host's memory (worlds, N), and what it was made from.
        self._is_current = False
        self._seen_revision = -1  # of the binder
        self._written: dict[SceneRecords, int] = {}  # with the `record_revision`
        self._instances: NDArray[Any] = np.zeros((0, 0))
        self._traced: NDArray[Any] = np.zeros((0, 0))
        self._written_key: Any = None
        self._written_blockers: Any = None
        self._written_light_index: NDArray[np.uint32] | None = None

    # ---- what others read ---------------------------------------------------------------------------

    @property
    def transforms(self) -> TransformOverrides:
        """The transforms of instances in each world. Raises SolariError where each world shows a scene of its own."""
        return self._needed_overrides("transforms", "the instances").transforms

    @property
    def materials(self) -> MaterialOverrides:
        """The materials of instances in each world, as `transforms`."""
        return self._needed_overrides("world_materials", "the instances").materials

    @property
    def lights(self) -> LightOverrides:
        """The lights in each world, as `transforms`."""
        return self._needed_overrides("world_lights", "the lights").lights

    def _needed_overrides(self, name: str, objects: str) -> WorldOverrides:
        if self.overrides is None:
            raise SolariError(
                f"Batch.{name} is for the worlds of one scene, and this batch has a list of scenes: change "
                f"{objects} of a world's scene, or make the batch of one scene with worlds="
            )
        return self.overrides

    @property
    def resources(self) -> Mapping[str, Any]:
        """Buffers by their names in GLSL."""
        return self._shared | self._buffers | {"world_structures": self._structures.addresses}

    @property
    def rows(self) -> int:
        """The number of rows of a world in `instances`."""
        return self._binder.instance_capacity

    @property
    def edit_counts(self) -> NDArray[np.int64]:
        """`SceneRecords.edit_counts` of each world (3, W), or of all (3, 1)."""
        return np.array([records.edit_counts for records in self._binder.listed_records]).T

    @property
    def light_states(self) -> list[LightState] | None:
        """What is known of the lights of each world; None where all have the scene's."""
        return self._lights.states if self._lights.tables else None

    @property
    def may_add_light(self) -> bool:
        """Whether a world may have light that its scene lacks: a light, or an unlit material, of its own."""
        if self.overrides is None:
            return False
        if any(len(state.ids) for state in self.light_states or ()):
            return True
        materials = self.overrides.materials.current().values()
        return any(material.unlit for of_worlds in materials for material in of_worlds)

    @property
    def assignment_key(self) -> tuple[int, ...]:
        """What `assign_views` writes depends on."""
        return self.rows, int(self.light_states is not None)

    def assign_views(self, table: ViewBuffer) -> None:
        """Write to the records of views which world each shows: as many views to each, one after the other."""
        table.shared["has_own_lights"] = self.light_states is not None
        records = table.records
        records["world"] = np.arange(len(records)) // (len(records) // self.count)
        records["first_instance"] = records["world"] * self.rows

    # ---- an update, step by step ---------------------------------------------------------------------

    def update(self) -> int:
        """Have the next submission show the worlds as they are, and their scenes, whose edits are applied; returns
        `version`. Raises SolariError for more worlds than the device holds, and for what worlds can't have."""
        if not self.has_tables:
            tlas = self._binder.tlas
            assert tlas is not None
            self._structures.set_addresses([tlas.current.address, (tlas.previous or tlas.current).address])
            return self.bindings_version
        is_new = not self._is_current or self._scenes_differ()
        if self.overrides is None:
            if is_new:
                self._show_scenes()
        elif is_new or self.overrides.changed:
            self._show_overrides(self.overrides, is_new)
        self._share_lights()
        return self.bindings_version

    def _scenes_differ(self) -> bool:
        """Whether a scene was edited so that its records differ from those that were written."""
        if self._seen_revision == self._binder.scene_revision:
            return False
        self._seen_revision = self._binder.scene_revision
        return any(self._written.get(records) != records.record_revision for records in self._worlds_of)

    def _show_scenes(self) -> None:
        """Have each world show its own scene."""
        was_current = self._is_current
        self._is_current = False  # until all is written
        self._scene_lights, keys = lists_of_scenes(self._binder.listed_records, self._scene_lights)
        if self._lights.set_lists(self._scene_lights, keys, self.rows) or not was_current:
            self._upload_lights()
        self._write({})
        self._is_current = True

    def _show_overrides(self, overrides: WorldOverrides, is_new: bool) -> None:
        """Have all worlds show the scene, with what each has in place of the scene's objects. is_new: the scene was
        edited, or an earlier update failed."""
        self._is_current = False  # until all is written
        overrides.forget_removed()
        moved = overrides.transforms.changed
        has_new_surfaces = is_new or bool(overrides.materials.changed)
        if overrides.materials.changed:
            self._binder.records.look_changes += 1
        if moved:
            self._binder.records.moves += 1
        if has_new_surfaces:
            self._overridden_instances.follow_materials(overrides)
        if any(map(self._overridden_instances.is_blended, moved)):
            self._binder.records.blended_changes += 1
        has_new_lights = has_new_surfaces or self._may_change_lights(overrides)
        if has_new_lights:
            self._follow_lights(overrides, must_upload=is_new)
        blockers = self._overridden_instances.blockers(overrides)
        differing = self._overridden_instances.all(overrides, blockers)
        # Lists of lights that are others often leave each emitter its row, which is all that instances say of lights.
        has_new_rows = self._lights.light_index is not self._written_light_index
        new_blockers = _key_of(blockers) != self._written_blockers
        # Also where the ball of a light is the scene's again.
        differ_elsewhere = self._written_key != self._array_key(differing)
        if not (has_new_lights or new_blockers or differ_elsewhere) and self._only_tensors_moved(overrides, differing):
            self._build(differing, moved)
        elif has_new_surfaces or has_new_rows or moved or new_blockers or differ_elsewhere:
            self._write(differing)
            self._written_blockers = _key_of(blockers)
        self._is_current = True
        overrides.confirm()

    def _only_tensors_moved(self, overrides: WorldOverrides, differing: Mapping[Instance, InstanceOverride]) -> bool:
        """Whether all transforms that changed are those that the device has, which it writes by itself."""
        moved = overrides.transforms.changed
        if not moved:
            return False
        transforms = [differing.get(instance, InstanceOverride()).transforms for instance in moved]
        return all(isinstance(values, DeviceTensor) for values in transforms)

    def _may_change_lights(self, overrides: WorldOverrides) -> bool:
        """Whether lights have changed, or instances have moved that emit light in the scene or in some world."""
        if overrides.lights.changed:
            return True
        emitting = self._world_light_lists.emitting
        scene_lights = self._binder.lights
        return any(one in emitting or scene_lights.index(one) is not None for one in overrides.transforms.changed)

    # ---- lights -------------------------------------------------------------------------------------

    def _follow_lights(self, overrides: WorldOverrides, must_upload: bool) -> None:
        keys = self._world_light_lists.make_lists(overrides)
        if keys is None:
            self._lights.share_scene_lights()
        elif self._lights.set_lists(self._world_light_lists.lists, keys, self.rows) or must_upload:
            self._upload_lights()

    def _upload_lights(self) -> None:
        for name, table in self._lights.tables.items():
            self._upload(name, table)

    def _share_lights(self) -> None:
        """Have `resources` name the scene's tables of lights, unless the worlds have some of their own."""
        shared: dict[str, Buffer] = {}
        if not self._lights.tables:
            shared = {table.name: table.buffer for table in self._binder.lights.tables}
            for name in shared.keys() & self._buffers.keys():
                self._buffers.pop(name).destroy()
        if shared != self._shared:
            self._shared = shared
            self.bindings_version += 1

    # ---- instances and their structures -------------------------------------------------------------

    def _array_key(self, differing: Mapping[Instance, InstanceOverride]) -> Any:
        """What the arrays of records depend on: their shape, and which fields each world has of its own. While it stays
        the same, a field that was overwritten is overwritten again."""
        overwritten = [
            (instance, override.transforms is None, override.materials is None)
            for instance, override in differing.items()
        ]
        most = max(records.traced.count for records in self._worlds_of)
        return self.rows, most, self._lights.light_index is None, (*overwritten,)

    def _write(self, differing: Mapping[Instance, InstanceOverride]) -> None:
        array_key = self._array_key(differing)
        if array_key != self._written_key:
            self._make_arrays(most=array_key[1])
            self._written_key = array_key
        outdated = {
            records: worlds
            for records, worlds in self._worlds_of.items()
            if self._written.get(records) != records.record_revision
        }
        for records, worlds in outdated.items():
            self._copy_scene(records, worlds)
        for instance, override in differing.items():
            self._write_override(instance, override)
        # All rows of all worlds, which would take most of the time of a frame in which one instance moves.
        light_index = self._lights.light_index
        if light_index is not None and (outdated or light_index is not self._written_light_index):
            self._instances["light_index"] = light_index
        self._written_light_index = light_index
        self._upload("instances", self._instances)
        # A world may have fewer instances than there is room for.
        counts = np.zeros(self.count, np.int64)
        for records, worlds in self._worlds_of.items():
            counts[worlds] = records.traced.count
        tlas = self._binder.tlas
        flat_tree = None if tlas is None else tlas.flat_tree
        self._structures.prepare(self._traced, tuple(counts.tolist()), flat_tree)
        self._build(differing, differing)

    def _make_arrays(self, most: int) -> None:
        """Make arrays for so many instances in the structure of a world."""
        scenes = list(self._worlds_of)
        dtype = scenes[0].instance_table.records.dtype
        limit = self._device.properties.limits.maxStorageBufferRange
        worlds = min(MAX_INSTANCES // self.rows, limit // (self.rows * dtype.itemsize))
        if self.count > worlds:
            shown = f"{len(scenes):,} scenes" if self.overrides is None else self._binder.scene.describe()
            raise SolariError(
                f"Batch: {self.count:,} worlds of {shown}, with {self.rows:,} rows of "
                f"instances each: this device holds at most {worlds:,}: share the worlds among several "
                "batches"
            )
        self._instances = np.zeros((self.count, self.rows), dtype)
        self._traced = np.zeros((self.count, most), INSTANCE_DTYPE)
        self._written = {}

    def _copy_scene(self, records: SceneRecords, worlds: NDArray[np.int64]) -> None:
        """Copy a scene's records to the worlds (W,) that show it."""
        instances = records.instance_table.records
        count = records.traced.count
        first_rows = (worlds * self.rows).astype(np.uint32)[:, None]
        self._instances[worlds, : len(instances)] = instances
        # A custom index is a row of `instances`, of which each world has its own.
        self._traced[worlds, :count] = records.traced.table.records[:count]
        self._traced["custom_index_and_mask"][worlds, :count] += first_rows
        self._written[records] = records.record_revision

    def _write_override(self, instance: Instance, override: InstanceOverride) -> None:
        records = self._binder.records
        row = records.instance_rows[instance]
        place = records.traced.record_index(row)
        if override.transforms is not None or override.materials is not None:
            # It isn't what the flat tree has.
            self._traced["sbt_offset_and_flags"][:, place] &= ~SLOT_MASK
            self._traced["blas_address"][:, place] = records.traced.use_own_tree(self._device, row)
        if override.transforms is not None and not isinstance(override.transforms, DeviceTensor):
            placed = override.transforms[:, :3].copy()
            self._binder.use_scale(instance, float(np.linalg.norm(placed[..., :3], axis=1).max()))
            placed[..., 3] -= records.origin
            self._instances["world_from_object"][:, row] = placed.transpose(0, 2, 1)
            self._traced["transform"][:, place] = placed
        if override.materials is not None:
            self._instances["material"][:, row] = override.materials
            self._traced["sbt_offset_and_flags"][:, place] = override.flags
        if override.masks is not None:
            # The mask stands above the index in the same number.
            index = self._traced["custom_index_and_mask"][:, place] & ROW_MASK
            self._traced["custom_index_and_mask"][:, place] = index | override.masks

    def _build(self, differing: Mapping[Instance, InstanceOverride], moved: Iterable[Instance]) -> None:
        """Build the structures, after the device has written the transforms of moved instances that it has itself."""
        for instance in moved:
            transforms = differing[instance].transforms
            if isinstance(transforms, DeviceTensor):
                self._write_tensor(instance, transforms)
        self._structures.build()

    def _write_tensor(self, instance: Instance, transforms: DeviceTensor) -> None:
        """Have the device write the transforms of an instance, (worlds, 4, 4), to all records that have them."""
        traced_records = self._structures.records
        fields = self._instances.dtype.fields
        assert traced_records is not None
        assert fields is not None
        row = self._binder.records.instance_rows[instance]
        index = self._binder.records.traced.record_index(row)
        # Where a world's records are, and from one world to the next, in floats. The records of shaders and those that
        # structures are built from have the numbers of a transform in different order.
        size = self._instances.dtype.itemsize // 4
        traced_size = INSTANCE_DTYPE.itemsize // 4
        places = {
            "first": self._buffers["instances"].address,
            "first_offset": row * size + fields["world_from_object"][1] // 4,
            "first_step": self.rows * size,
            "second": traced_records.address,
            "second_offset": index * traced_size,
            "second_step": self._traced.shape[1] * traced_size,
        }
        name = instance.describe()
        field = f"Batch.transforms: {name}"
        pushed = {
            **self.port.matrices(transforms, self.count, self._binder.origin),
            **self.port.refusal(field, rule(field, "world", POSE_RULE)),
            **places,
        }
        self.port.write([Dispatch("transforms", (self.count, 1), pushed)], name, with_next=True)

    def _upload(self, name: str, records: NDArray[Any]) -> None:
        before = self._buffers.get(name)
        self._buffers[name] = uploaded(self._device, before, records, name)
        if self._buffers[name] is not before:
            self.bindings_version += 1

    def destroy(self) -> None:
        if self.overrides is not None:
            self.overrides.destroy()
        self._world_light_lists.destroy()
        self._structures.destroy()
        for buffer in self._buffers.values():
            buffer.destroy()


def _key_of(blockers: Mapping[Any, Any]) -> Any:
    """What records have of the balls of lights."""
    return [(instance, own.transforms.tobytes(), own.masks.tobytes()) for instance, own in blockers.items()]
