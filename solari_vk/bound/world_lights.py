"""The lights of worlds that have some of their own: the tables of light_list.py, one world's rows after the other's.

Each world has as many rows of a table as the world that needs most. Worlds with the same lights share one LightList in
the host's memory, which is made anew when one of its lights, or those of the scene, change.
"""

from __future__ import annotations

import copy
import weakref
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.constants import NO_INDEX
from solari_vk.bound.lights.light_list import LightList
from solari_vk.bound.lights.own_buffers import OwnBuffers, own_data
from solari_vk.bound.lights.world_changes import Known
from solari_vk.bound.world_objects import WorldLights, WorldMaterials, WorldTransforms
from solari_vk.errors import SolariError
from solari_vk.gpu.device.device import Device
from solari_vk.scene.lights.portal import Portal
from solari_vk.scene.model import Instance, Light, Material

FIRST_ID = 1 << 31  # of lights that aren't in the scene
Lamp = tuple[Instance, Material, NDArray[np.float64] | None]
"""An instance that emits light in a world: the scene's, its material, its transform if it has one of its own."""


class Listed(NamedTuple):
    """The lights of some worlds. lamps: in the list's order, and the stand-ins for them that are in the list."""

    lights: LightList
    lamps: list[Instance]
    stand_ins: list[Instance]
    known: Known


class LightsOfWorlds:
    """The light tables of a batch's worlds, in the host's memory."""

    def __init__(self, device: Device, binder: SceneBinder, worlds: int) -> None:
        self._binder, self._worlds, self._device = binder, worlds, device
        self._layout = {table.name: table.records.dtype for table in binder.lights.tables}
        self.tables: dict[str, NDArray[Any]] = {}
        """By the names in GLSL (worlds, rows); none while all worlds share the scene's lights."""
        self.known: list[Known] = []
        """For each world, or one for all that share the scene's lights. What has changed is another object."""
        self.lamp_rows: dict[Instance, NDArray[np.uint32]] = {}
        """The rows in `light_sources` (worlds,) of instances that emit light in some world, NO_INDEX elsewhere."""
        self._own = OwnBuffers(device, self._layout["light_leaves"]["by_power"])
        self._ids = weakref.WeakKeyDictionary[Instance | Light, tuple[int, Any]]()
        self._last_id = FIRST_ID
        self._lists: dict[Any, Listed] = {}
        self._shown: list[Any] = []  # the key of each world's list
        self._rows = 0  # of a world in `instances`

    def update(self, lights: WorldLights, materials: WorldMaterials, transforms: WorldTransforms, rows: int) -> bool:
        """Follow what the worlds have of their own, when the scene's edits are applied. rows: of a world in
        `instances`. Returns whether the worlds have lights of their own."""
        own_lights, moved, made_of = lights.present(), transforms.present(), materials.present()
        scene = self._binder.scene
        lamps = [instance for instance in scene.instances if self._binder.lights.index(instance) is not None
                 or any(material.emits for material in made_of.get(instance, ()))]  # fmt: skip
        places = transforms.on_host(lamps)
        if not own_lights and not any(lamp in moved or lamp in made_of for lamp in lamps):
            self._forget()
            self.known = [Known.of(self._binder.lights)]
            return False
        listed = {light: own_lights.get(light) for light in scene.lights}
        if any(isinstance(light, Portal) for light in listed):
            raise SolariError(f"Batch: worlds have lights of their own, and {scene.describe()} has a "
                              "portal: remove it, or give all worlds the scene's lights")  # fmt: skip
        lists: dict[Any, Listed] = {}
        poses = {lamp: _pose_key(lamp) for lamp in lamps}
        shown = []
        for world in range(self._worlds):
            own = [(light if given is None else given[world]) for light, given in listed.items()]
            _check_once(own, world)
            lit = [(lamp, made_of[lamp][world] if lamp in made_of else lamp.material,
                    places[lamp][world] if lamp in places else None) for lamp in lamps]  # fmt: skip
            lit = [one for one in lit if one[0].visible and one[1].emits]
            lights_key = [(id(light), lights.edits_of(light)) for light in own]
            lamps_key = [(id(lamp), *_emission_key(made), (lamp.transform if at is None else at).tobytes(), poses[lamp])
                         for lamp, made, at in lit]  # fmt: skip
            key = self._binder.light_revision, (*lights_key,), (*lamps_key,)
            if key not in lists:
                lists[key] = self._lists.get(key) or self._make(own, lit)
            shown.append(key)
        self._drop({key: listed for key, listed in self._lists.items() if key not in lists})
        self._lists = lists
        self._keep_buffers(listed, own_lights)
        self._write(shown, lamps, rows)
        return True

    def _make(self, own: Sequence[Light | None], lit: Sequence[Lamp]) -> Listed:
        binder, made = self._binder, LightList(self._device, self._layout, self._own)
        stand_ins = []
        for lamp, material, transform in lit:
            stand_in = copy.copy(lamp)
            stand_in.update(material=material, **({} if transform is None else {"transform": transform}))
            made.set_emissive(stand_in, binder.instance_rows[lamp], *binder.lamps.of(stand_in, lamp))
            stand_ins.append(stand_in)
        for light in own:
            if light is not None:
                binder.note_feature(light)
                made.set_light(light, True)
        made.update(binder.traced.lit_area)
        lamps = [lamp for lamp, _, _ in lit]
        listed: list[Instance | Light] = [*lamps, *(light for of_kind in made.others.values() for light in of_kind)]
        ids = np.fromiter(map(self._id, listed), np.uint32, len(listed))
        return Listed(made, lamps, stand_ins, Known.of(made)._replace(ids=ids))

    def _id(self, light: Instance | Light) -> int:
        """A number that stays with a light while it has the same image or profile: the scene's, if it has one."""
        found = self._binder.lights.id_of(light)
        if found is not None:
            return found
        data = own_data(light)
        if light not in self._ids or self._ids[light][1] is not data:
            self._last_id += 1
            self._ids[light] = self._last_id, data
        return self._ids[light][0]

    def _write(self, shown: list[Any], lamps: list[Instance], rows: int) -> None:
        sizes = dict.fromkeys(self._layout, 1)
        for listed in self._lists.values():
            for name, count in _counts(listed.lights).items():
                sizes[name] = max(sizes[name], count)
        if rows != self._rows:
            self._rows, self._shown = rows, []
        if {name: table.shape[1] for name, table in self.tables.items()} != sizes:
            limit = self._device.properties.limits.maxStorageBufferRange
            for name, size in sizes.items():
                most = limit // (size * self._layout[name].itemsize)
                if self._worlds > most:
                    raise SolariError(f"Batch: {self._worlds:,} worlds with lights of their own, of which one has "
                                      f"{size:,} rows of {name}: this device holds at most {most:,}: share the worlds "
                                      "among several batches")  # fmt: skip
            self.tables = {name: np.zeros((self._worlds, size), self._layout[name]) for name, size in sizes.items()}
            self._shown = []
        if not self._shown:
            self._shown, self.known = [None] * self._worlds, [Known.of(self._binder.lights)] * self._worlds
        self.lamp_rows = {lamp: self.lamp_rows.get(lamp, np.full(self._worlds, NO_INDEX, np.uint32)) for lamp in lamps}
        changed: dict[Any, list[int]] = {}
        for world, (key, old) in enumerate(zip(shown, self._shown, strict=True)):
            if key != old:
                changed.setdefault(key, []).append(world)
                self.known[world] = self._lists[key].known
        for key, worlds in changed.items():
            self._write_list(np.array(worlds), self._lists[key], rows)
        self._shown = shown

    def _write_list(self, worlds: NDArray[np.int64], listed: Listed, rows: int) -> None:
        """Write the rows of worlds (W,) that share a list, whose indices then count from each world's first row on."""
        made, lamp_count = listed.lights, len(listed.lamps)
        first = {name: (worlds * table.shape[1]).astype(np.uint32)[:, None] for name, table in self.tables.items()}

        def tiled(name: str, records: NDArray[Any]) -> NDArray[Any]:
            return np.tile(records, (len(worlds), 1))

        def put(name: str, records: NDArray[Any]) -> None:
            self.tables[name][worlds, : records.shape[1]] = records

        count = len(made.ids)
        sources = tiled("light_sources", made.sources.records[:count])
        sources["first_leaf"] += first["light_leaves"]
        sources["record_index"][:, :lamp_count] += (worlds * rows).astype(np.uint32)[:, None]
        row = lamp_count
        for kind in made.others:
            records, name = made.records(kind), str(kind.buffer)
            sources["record_index"][:, row : row + len(records)] += first[name]
            row += len(records)
            put(name, tiled(name, records))
        put("light_sources", sources)
        leaves = tiled("light_leaves", made.leaves.table.records[: made.leaves.count])
        leaves["by_power"]["alias"] += first["light_leaves"]
        leaves["light"] += first["light_sources"]
        leaves["node"] += np.where(leaves["node"] == NO_INDEX, 0, first["light_tree"]).astype(np.uint32)
        put("light_leaves", leaves)
        nodes = tiled("light_tree", made.leaves.tree.records[: made.leaves.node_count])
        nodes["first"] += np.where(nodes["child_count"] > 0, first["light_tree"], first["light_leaves"])
        nodes["parent"] += first["light_tree"]
        put("light_tree", nodes)
        info = tiled("scene_infos", made.info.records[:1])
        for name in ("first_portal", "first_pass_through_light", "first_light_at_infinity", "light_end"):
            info[name] += first["light_sources"]
        info["first_environment"] += first["light_sources"] - first["environments"]
        info["first_leaf"], info["light_root"] = first["light_leaves"], first["light_tree"]
        put("scene_infos", info)
        for lamp, of_lamp in self.lamp_rows.items():
            place = listed.lamps.index(lamp) if lamp in listed.lamps else None
            of_lamp[worlds] = NO_INDEX if place is None else first["light_sources"][:, 0] + place

    def _keep_buffers(
        self, listed: Mapping[Light, list[Light | None] | None], own: Mapping[Light, list[Light | None]]
    ) -> None:
        used = {*listed, *(light for given in own.values() for light in given)}
        for light in [light for light in self._own if light not in used]:
            self._own.set(light, None)

    def _drop(self, lists: Mapping[Any, Listed]) -> None:
        for listed in lists.values():
            for stand_in in listed.stand_ins:
                self._binder.lamps.emissions.release(stand_in)

    def _forget(self) -> None:
        self._drop(self._lists)
        self._keep_buffers({}, {})
        self._lists, self.tables, self.lamp_rows, self._shown = {}, {}, {}, []

    def destroy(self) -> None:
        """Free everything."""
        self._forget()
        self._own.destroy()


def _check_once(lights: Sequence[Light | None], world: int) -> None:
    given = [light for light in lights if light is not None]
    if len(set(given)) < len(given):
        twice = next(light for light in given if given.count(light) > 1)
        raise SolariError(f"Batch.world_lights: {twice.describe()} takes the places of two lights in world {world}: "
                          "give a copy.copy of it for one of them")  # fmt: skip


def _emission_key(material: Material) -> tuple[Any, ...]:
    """What a list of lights depends on of a lamp's material."""
    return material.emissive.tobytes(), id(material.emissive_texture), material.double_sided


def _pose_key(lamp: Instance) -> tuple[bytes | None, ...]:
    pose = lamp.joint_matrices, lamp.morph_weights
    return tuple(None if values is None else np.asarray(values).tobytes() for values in pose)


def _counts(made: LightList) -> dict[str, int]:
    """The rows of each table."""
    counts = {str(kind.buffer): len(made.records(kind)) for kind in made.others}
    return counts | {
        "light_sources": len(made.ids), "light_leaves": made.leaves.count, "light_tree": made.leaves.node_count,
    }  # fmt: skip
