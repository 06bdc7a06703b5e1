"""The lights of a batch's worlds: the tables of bound/lights/light_list.py, one world's rows after the other's.

Worlds with the same lights share one LightList in the host's memory. Worlds of several scenes have those of their
scenes. Worlds of one scene that have lights, or emitting instances, of their own have lists that are made here.
"""

from __future__ import annotations

import copy
import weakref
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.batch.light_changes import LightState
from solari_vk.batch.overrides import WorldOverrides
from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.constants import NO_INDEX
from solari_vk.bound.lights.light_data import LightData, data_of
from solari_vk.bound.lights.light_list import LightList
from solari_vk.bound.scene_records import SceneRecords
from solari_vk.gpu.device.device import Device
from solari_vk.scene.lights.portal import Portal
from solari_vk.scene.model import Instance, Light, Material

FIRST_ID = 1 << 31  # of lights that aren't in the scene, whose own numbers count from 1


class SharedList(NamedTuple):
    """A list of lights that some worlds share."""

    lights: LightList
    emitter_rows: NDArray[np.int64]
    """The rows in `instances` of the instances that emit light, in the order of the list."""
    state: LightState
    emitters: Sequence[Instance] = ()
    """Copies of the scene's instances, with the materials and transforms that they have in these worlds."""


class WorldLights:
    """The light tables of worlds in the host's memory. Each world has as many rows of a table as the world that needs
    most. scene_lights: the lights that worlds without their own share, which have the tables' layout."""

    def __init__(self, device: Device, scene_lights: LightList, count: int) -> None:
        self.tables: dict[str, NDArray[Any]] = {}
        """By the names in GLSL (worlds, rows); none while all worlds share the scene's lights."""
        self.light_index: NDArray[np.uint32] | None = None
        """For each row of `instances` of each world (worlds, rows) its row in `light_sources`, NO_INDEX for instances
        that emit nothing. None while all worlds share the scene's lights. Each change makes a new array."""
        self.states: list[LightState] = []
        """For each world, or one for all that share the scene's lights. Each change makes a new object."""
        self._device = device
        self._count = count
        self._scene_lights = scene_lights
        self._dtypes = {table.name: table.records.dtype for table in scene_lights.tables}
        self._keys: Sequence[Any] = ()  # the key of each world's list

    def share_scene_lights(self) -> None:
        """Have all worlds share the scene's lights."""
        self.tables = {}
        self.light_index = None
        self.states = [LightState.of(self._scene_lights)]
        self._keys = ()

    def set_lists(self, lists: Mapping[Any, SharedList], keys: Sequence[Any], instance_rows: int) -> bool:
        """Have worlds (W,) show lists by their keys, which change with a list. instance_rows: of a world in
        `instances`. Returns whether tables have changed."""
        if self._make_tables(lists.values()) or self.light_index is None or self.light_index.shape[1] != instance_rows:
            self._keys = ()
        if not self._keys:
            self._keys = [None] * self._count
            self.states = [LightState.of(self._scene_lights)] * self._count
        # Worlds that changed to the same list are written at once.
        changed: dict[Any, list[int]] = {}
        for world, (key, old) in enumerate(zip(keys, self._keys, strict=True)):
            if key != old:
                changed.setdefault(key, []).append(world)
                self.states[world] = lists[key].state
        if changed:
            self._write(changed, lists, instance_rows)
        self._keys = keys
        return bool(changed)

    def _make_tables(self, lists: Iterable[SharedList]) -> bool:
        """Make the tables anew if lists need more or fewer rows; returns whether they were."""
        sizes = dict.fromkeys(self._dtypes, 1)
        for shared in lists:
            for name, count in _row_counts(shared.lights).items():
                sizes[name] = max(sizes[name], count)
        if {name: table.shape[1] for name, table in self.tables.items()} == sizes:
            return False
        limit = self._device.properties.limits.maxStorageBufferRange
        for name, size in sizes.items():
            most = limit // (size * self._dtypes[name].itemsize)
            if self._count > most:
                raise SolariError(
                    f"Batch: {self._count:,} worlds with lights of their own, of which one has "
                    f"{size:,} rows of {name}: this device holds at most {most:,}: share the worlds "
                    "among several batches"
                )
        self.tables = {name: np.zeros((self._count, size), self._dtypes[name]) for name, size in sizes.items()}
        return True

    def _write(self, changed: Mapping[Any, list[int]], lists: Mapping[Any, SharedList], instance_rows: int) -> None:
        shape = self._count, instance_rows
        before = self.light_index
        index = before.copy() if before is not None and before.shape == shape else np.full(shape, NO_INDEX, np.uint32)
        for key, numbers in changed.items():
            worlds = np.array(numbers)
            shared = lists[key]
            self._write_list(worlds, shared, instance_rows)
            first_rows = worlds * self.tables["light_sources"].shape[1]
            index[worlds] = NO_INDEX
            index[worlds[:, None], shared.emitter_rows] = first_rows[:, None] + np.arange(len(shared.emitter_rows))
        if before is None or not np.array_equal(index, before):
            self.light_index = index

    def _write_list(self, worlds: NDArray[np.int64], shared: SharedList, instance_rows: int) -> None:
        """Write the rows of worlds (W,) that share a list, whose indices then count from each world's first row on."""
        lights = shared.lights
        emitter_count = len(shared.emitter_rows)
        first = {name: (worlds * table.shape[1]).astype(np.uint32)[:, None] for name, table in self.tables.items()}

        def tiled(records: NDArray[Any]) -> NDArray[Any]:
            return np.tile(records, (len(worlds), 1))

        def put(name: str, records: NDArray[Any]) -> None:
            self.tables[name][worlds, : records.shape[1]] = records

        # Lights name rows of other tables: their leaves, and instances or records of their kind.
        sources = tiled(lights.sources.records[: len(lights.ids)])
        sources["first_leaf"] += first["light_leaves"]
        sources["record_index"][:, :emitter_count] += (worlds * instance_rows).astype(np.uint32)[:, None]
        row = emitter_count
        for kind in lights.lights_by_kind:
            records = lights.records(kind)
            name = str(kind.buffer)
            sources["record_index"][:, row : row + len(records)] += first[name]
            row += len(records)
            put(name, tiled(records))
        put("light_sources", sources)

        leaves = tiled(lights.leaves.table.records[: lights.leaves.count])
        leaves["by_power"]["alias"] += first["light_leaves"]
        leaves["light"] += first["light_sources"]
        leaves["node"] += np.where(leaves["node"] == NO_INDEX, 0, first["light_tree"]).astype(np.uint32)
        put("light_leaves", leaves)

        # A node without children is a leaf, whose first index is that of a row of `light_leaves`.
        nodes = tiled(lights.leaves.tree.records[: lights.leaves.node_count])
        nodes["first"] += np.where(nodes["child_count"] > 0, first["light_tree"], first["light_leaves"])
        nodes["parent"] += first["light_tree"]
        put("light_tree", nodes)

        info = tiled(lights.info.records[:1])
        for name in ("first_portal", "first_pass_through_light", "first_light_at_infinity", "light_end"):
            info[name] += first["light_sources"]
        # A light's row is this number plus the index of its record, which counts from the first world's records on.
        info["first_environment"] += first["light_sources"] - first["environments"]
        info["first_portal_record"] = first["portals"]
        info["first_leaf"] = first["light_leaves"]
        info["light_root"] = first["light_tree"]
        put("scene_infos", info)


def _row_counts(lights: LightList) -> dict[str, int]:
    """The rows of each table."""
    counts = {str(kind.buffer): len(lights.records(kind)) for kind in lights.lights_by_kind}
    return counts | {
        "light_sources": len(lights.ids),
        "light_leaves": lights.leaves.count,
        "light_tree": lights.leaves.node_count,
    }


def lists_of_scenes(
    worlds: Sequence[SceneRecords], known: Mapping[Any, SharedList]
) -> tuple[dict[Any, SharedList], list[Any]]:
    """What `WorldLights.set_lists` takes where each world has the lights of its own scene. known: the lists so far."""
    keys = [(id(records), sum(table.revision for table in records.lights.tables)) for records in worlds]
    lists = {}
    for key, records in dict(zip(keys, worlds, strict=True)).items():
        lists[key] = known.get(key) or SharedList(
            records.lights, _rows_of(records, records.lights.emissive), LightState.of(records.lights)
        )
    return lists, keys


def _rows_of(records: SceneRecords, instances: Iterable[Instance]) -> NDArray[np.int64]:
    return np.array([records.instance_rows[instance] for instance in instances], np.int64)


class _Emitter(NamedTuple):
    """An instance of the scene that emits light in a world, with its material there, and its transform there if that
    isn't the scene's."""

    instance: Instance
    material: Material
    transform: NDArray[np.float64] | None


class WorldLightLists:
    """The lists of worlds of one scene whose overrides concern lights. A list is made anew when one of its lights, or
    those of the scene, change."""

    def __init__(self, device: Device, binder: SceneBinder, count: int) -> None:
        self.lists: dict[Any, SharedList] = {}
        """By keys of all that a list depends on."""
        self.emitting: set[Instance] = set()
        """The instances that emit light in some world, or in the scene, while there are lists."""
        self._device = device
        self._binder = binder
        self._count = count
        self._dtypes = {table.name: table.records.dtype for table in binder.lights.tables}
        self._data = LightData(device, self._dtypes["light_leaves"]["by_power"])
        self._ids = weakref.WeakKeyDictionary[Instance | Light, tuple[int, Any]]()
        self._last_id = FIRST_ID

    def make_lists(self, overrides: WorldOverrides) -> list[Any] | None:
        """Make the lists of all worlds, with the scene's edits applied; returns the key of each world's list, or None
        if all worlds have the scene's lights."""
        materials = overrides.materials.current()
        moved = overrides.transforms.current()
        lights_of = overrides.lights.current()
        emitting = self._emitting(materials)
        if not lights_of and not any(instance in moved or instance in materials for instance in emitting):
            self.clear()
            return None
        self._check_portals()
        poses = {instance: _pose_key(instance) for instance in emitting}
        # An emitter's transform must be on the host, also if a tensor has it.
        transforms = overrides.transforms.on_host(emitting)
        scene_lights = list(self._binder.scene.lights)
        lists: dict[Any, SharedList] = {}
        keys = []
        for world in range(self._count):
            lights = _lights_in(world, scene_lights, lights_of)
            emitters = _emitters_in(world, emitting, materials, transforms)
            key = self._key(lights, emitters, overrides, poses)
            if key not in lists:
                lists[key] = self.lists.get(key) or self._make(lights, emitters)
            keys.append(key)
        self._release([shared for key, shared in self.lists.items() if key not in lists])
        self.lists = lists
        self.emitting = set(emitting)
        self._keep_buffers_of(overrides)
        return keys

    def _emitting(self, materials: Mapping[Instance, Sequence[Material]]) -> list[Instance]:
        """The instances that emit light in some world, or in the scene. materials: of worlds."""
        found = []
        for instance in self._binder.scene.instances:
            in_worlds = any(material.emits for material in materials.get(instance, ()))
            if in_worlds or self._binder.lights.index(instance) is not None:
                found.append(instance)
        return found

    def _check_portals(self) -> None:
        scene = self._binder.scene
        if any(isinstance(light, Portal) for light in scene.lights):
            raise SolariError(
                f"Batch: worlds have lights of their own, and {scene.describe()} has a "
                "portal: remove it, or give all worlds the scene's lights"
            )

    def _key(
        self,
        lights: Sequence[Light],
        emitters: Sequence[_Emitter],
        overrides: WorldOverrides,
        poses: Mapping[Instance, Any],
    ) -> Any:
        """All that the list of a world depends on."""
        # Ids of objects that the lists keep alive, so that no other object gets the same id.
        of_lights = [(id(light), overrides.lights.edits_of(light)) for light in lights]
        of_emitters = []
        for instance, material, transform in emitters:
            emission = material.emissive.tobytes(), id(material.emissive_texture), material.double_sided
            place = instance.transform if transform is None else transform
            of_emitters.append((id(instance), *emission, place.tobytes(), poses[instance]))
        return self._binder.records.light_revision, (*of_lights,), (*of_emitters,)

    def _make(self, lights: Sequence[Light], emitters: Sequence[_Emitter]) -> SharedList:
        binder = self._binder
        records = binder.records
        made = LightList(self._device, self._dtypes, self._binder.origin, self._data)
        copies = []
        for instance, material, transform in emitters:
            # A copy of the instance takes its place in the list, with what it has in this world.
            placed = {} if transform is None else {"transform": transform}
            emitter = copy.copy(instance)
            emitter.update(material=material, **placed)
            made.set_emissive(emitter, records.instance_rows[instance], *records.emission_of(emitter, instance))
            copies.append(emitter)
        for light in lights:
            binder.add_feature(light)
            made.set_light(light, True)
        made.update(records.traced.lit_area)
        binder.add_feature(made.leaves.choice)
        # Lights keep their numbers when a list is made anew, by which frames find them again.
        listed: list[Instance | Light] = [emitter.instance for emitter in emitters]
        for of_kind in made.lights_by_kind.values():
            listed += of_kind
        ids = np.fromiter(map(self._id, listed), np.uint32, len(listed))
        rows = _rows_of(records, [emitter.instance for emitter in emitters])
        return SharedList(made, rows, LightState.of(made)._replace(ids=ids), copies)

    def _id(self, light: Instance | Light) -> int:
        """A number that stays with a light while it has the same image or profile: the scene's, if it has one."""
        found = self._binder.lights.id_of(light)
        if found is not None:
            return found
        data = data_of(light)
        if light not in self._ids or self._ids[light][1] is not data:
            self._last_id += 1
            self._ids[light] = self._last_id, data
        return self._ids[light][0]

    def _keep_buffers_of(self, overrides: WorldOverrides) -> None:
        """Free the images and profiles of lights that no world has any more."""
        used = {*self._binder.scene.lights}
        for lights in overrides.lights.current().values():
            used |= {light for light in lights if light is not None}
        for light in [light for light in self._data if light not in used]:
            self._data.set(light, None)

    def _release(self, lists: Iterable[SharedList]) -> None:
        for shared in lists:
            for emitter in shared.emitters:
                self._binder.records.emissions.release(emitter)

    def clear(self) -> None:
        """Free all lists, and the images and profiles of their lights."""
        self._release(self.lists.values())
        self.lists = {}
        self.emitting = set()
        for light in list(self._data):
            self._data.set(light, None)

    def destroy(self) -> None:
        self.clear()
        self._data.destroy()


def _lights_in(
    world: int, scene_lights: Sequence[Light], overrides: Mapping[Light, Sequence[Light | None]]
) -> list[Light]:
    """The lights of a world that are no instances."""
    found = [overrides[light][world] if light in overrides else light for light in scene_lights]
    lights = [light for light in found if light is not None]
    if len(set(lights)) < len(lights):
        twice = next(light for light in lights if lights.count(light) > 1)
        raise SolariError(
            f"Batch.world_lights: {twice.describe()} takes the places of two lights in world {world}: "
            "give a copy.copy of it for one of them"
        )
    return lights


def _emitters_in(
    world: int,
    instances: Sequence[Instance],
    materials: Mapping[Instance, Sequence[Material]],
    transforms: Mapping[Instance, NDArray[np.float64]],
) -> list[_Emitter]:
    """Those of the instances that emit light in a world. materials, transforms: by world, where they differ."""
    found = []
    for instance in instances:
        material = materials[instance][world] if instance in materials else instance.material
        transform = transforms[instance][world] if instance in transforms else None
        if instance.visible and material.emits:
            found.append(_Emitter(instance, material, transform))
    return found


def _pose_key(instance: Instance) -> tuple[bytes | None, ...]:
    pose = instance.joint_matrices, instance.morph_weights
    return tuple(None if values is None else np.asarray(values).tobytes() for values in pose)
