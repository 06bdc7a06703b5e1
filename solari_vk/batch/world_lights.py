"""The lights of worlds of one scene that have some of their own.

A list of lights is made anew when one of its lights, or those of the scene, change.
"""

from __future__ import annotations

import copy
import weakref
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.batch.light_tables import LightTables, Listed
from solari_vk.batch.world_changes import Known
from solari_vk.batch.world_objects import WorldLights, WorldMaterials, WorldTransforms
from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.lights.light_data import LightData, data_of
from solari_vk.bound.lights.light_list import LightList
from solari_vk.gpu.device.device import Device
from solari_vk.scene.lights.portal import Portal
from solari_vk.scene.model import Instance, Light, Material

FIRST_ID = 1 << 31  # of lights that aren't in the scene
Lamp = tuple[Instance, Material, NDArray[np.float64] | None]
"""An instance that emits light in a world: the scene's, its material, its transform if it has one of its own."""


class LightsOfWorlds(LightTables):
    """The light tables of worlds of one scene."""

    def __init__(self, device: Device, binder: SceneBinder, worlds: int) -> None:
        super().__init__(device, binder.lights, worlds)
        self._binder = binder
        self._data = LightData(device, self._layout["light_leaves"]["by_power"])
        self._ids = weakref.WeakKeyDictionary[Instance | Light, tuple[int, Any]]()
        self._last_id = FIRST_ID

    def update(self, lights: WorldLights, materials: WorldMaterials, transforms: WorldTransforms, rows: int) -> bool:
        """Follow what the worlds have of their own, when the scene's edits are applied. rows: of a world in
        `instances`. Returns whether the worlds have lights of their own."""
        own_lights, moved, made_of = lights.present(), transforms.present(), materials.present()
        scene = self._binder.scene
        lamps = [
            instance
            for instance in scene.instances
            if self._binder.lights.index(instance) is not None
            or any(material.emits for material in made_of.get(instance, ()))
        ]
        places = transforms.on_host(lamps)
        if not own_lights and not any(lamp in moved or lamp in made_of for lamp in lamps):
            self._forget()
            self.known = [Known.of(self._binder.lights)]
            return False
        listed = {light: own_lights.get(light) for light in scene.lights}
        if any(isinstance(light, Portal) for light in listed):
            raise SolariError(
                f"Batch: worlds have lights of their own, and {scene.describe()} has a "
                "portal: remove it, or give all worlds the scene's lights"
            )
        lists: dict[Any, Listed] = {}
        poses = {lamp: _pose_key(lamp) for lamp in lamps}
        shown = []
        for world in range(self._worlds):
            own = [(light if given is None else given[world]) for light, given in listed.items()]
            _check_once(own, world)
            lit = [
                (
                    lamp,
                    made_of[lamp][world] if lamp in made_of else lamp.material,
                    places[lamp][world] if lamp in places else None,
                )
                for lamp in lamps
            ]
            lit = [one for one in lit if one[0].visible and one[1].emits]
            lights_key = [(id(light), lights.edits_of(light)) for light in own]
            lamps_key = [
                (id(lamp), *_emission_key(made), (lamp.transform if at is None else at).tobytes(), poses[lamp])
                for lamp, made, at in lit
            ]
            key = self._binder.records.light_revision, (*lights_key,), (*lamps_key,)
            if key not in lists:
                lists[key] = self._lists.get(key) or self._make(own, lit)
            shown.append(key)
        self._drop({key: listed for key, listed in self._lists.items() if key not in lists})
        self._lists = lists
        self._keep_buffers(listed, own_lights)
        self._write(shown, lamps, rows)
        return True

    def _make(self, own: Sequence[Light | None], lit: Sequence[Lamp]) -> Listed:
        binder, made = self._binder, LightList(self._device, self._layout, self._data)
        stand_ins = []
        for lamp, material, transform in lit:
            stand_in = copy.copy(lamp)
            stand_in.update(material=material, **({} if transform is None else {"transform": transform}))
            made.set_emissive(stand_in, binder.records.instance_rows[lamp], *binder.records.emission_of(stand_in, lamp))
            stand_ins.append(stand_in)
        for light in own:
            if light is not None:
                binder.add_feature(light)
                made.set_light(light, True)
        made.update(binder.records.traced.lit_area)
        binder.add_feature(made.leaves.light_tree)
        lamps = [lamp for lamp, _, _ in lit]
        listed: list[Instance | Light] = [*lamps, *(light for of_kind in made.others.values() for light in of_kind)]
        ids = np.fromiter(map(self._id, listed), np.uint32, len(listed))
        return Listed(made, lamps, stand_ins, Known.of(made)._replace(ids=ids))

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

    def _keep_buffers(
        self, listed: Mapping[Light, list[Light | None] | None], own: Mapping[Light, list[Light | None]]
    ) -> None:
        used = {*listed, *(light for given in own.values() for light in given)}
        for light in [light for light in self._data if light not in used]:
            self._data.set(light, None)

    def _drop(self, lists: Mapping[Any, Listed]) -> None:
        for listed in lists.values():
            for stand_in in listed.stand_ins:
                self._binder.records.emissions.release(stand_in)

    def _forget(self) -> None:
        self._drop(self._lists)
        self._keep_buffers({}, {})
        self._lists, self.tables, self.lamp_rows, self._shown = {}, {}, {}, []

    def destroy(self) -> None:
        """Free everything."""
        self._forget()
        self._data.destroy()


def _check_once(lights: Sequence[Light | None], world: int) -> None:
    given = [light for light in lights if light is not None]
    if len(set(given)) < len(given):
        twice = next(light for light in given if given.count(light) > 1)
        raise SolariError(
            f"Batch.world_lights: {twice.describe()} takes the places of two lights in world {world}: "
            "give a copy.copy of it for one of them"
        )


def _emission_key(material: Material) -> tuple[Any, ...]:
    """What a list of lights depends on of a lamp's material."""
    return material.emissive.tobytes(), id(material.emissive_texture), material.double_sided


def _pose_key(lamp: Instance) -> tuple[bytes | None, ...]:
    pose = lamp.joint_matrices, lamp.morph_weights
    return tuple(None if values is None else np.asarray(values).tobytes() for values in pose)
