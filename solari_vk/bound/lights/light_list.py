"""The list of light sources: all visible emissive instances, then all other lights by where rays meet them."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.constants import NO_INDEX
from solari_vk.bound.lights import light_kinds
from solari_vk.bound.lights.blockers import Blockers
from solari_vk.bound.lights.clusters import ClusterBoxes
from solari_vk.bound.lights.emissive_meshes import ONE_PART, Emission
from solari_vk.bound.lights.light_data import LightData, SharedBuffers, data_of
from solari_vk.bound.lights.light_kinds import AT_INFINITY, BEYOND, KIND_INDEX, PASSED, PLACES, LightKind, kind_of
from solari_vk.bound.lights.light_leaves import LightLeaves, choice_weights_by_kind
from solari_vk.bound.lights.portal_maps import PortalMaps
from solari_vk.bound.table import HostTable, MakeTable, Table
from solari_vk.gpu.device.device import Device
from solari_vk.scene.lights.environment import EnvironmentLight
from solari_vk.scene.lights.portal import Portal
from solari_vk.scene.model import Instance, Light

Position = tuple[float, float, float]
ORIGIN = (0.0, 0.0, 0.0)


class LightList:
    """The tables `light_sources` and `scene_infos`, and one for each kind that has a buffer of records.

    An emissive instance takes the index behind the others; when it is removed, the last one takes its place. All other
    lights follow. When lights are added or removed, all rows are uploaded; when they change their power, the leaves of
    all, whose probabilities change. When lights move, only their records and nodes of the tree are.

    data: for a list in the host's memory alone: the data of its maker, who has blockers too, or what scenes share.
    """

    def __init__(self, device: Device, layout: dict[str, Any], data: LightData | SharedBuffers | None = None) -> None:
        table: MakeTable = partial(Table, device) if data is None else HostTable
        self.sources = table("light_sources", layout["light_sources"])
        self.info = table("scene_infos", layout["scene_infos"])
        self.leaves = LightLeaves(table, layout)
        self._index_of_kind = {kind: index for index, kind in enumerate(light_kinds.LIGHT_KINDS)}
        self._mesh_kind = next(kind for kind in self._index_of_kind if kind.source is Instance)
        with_records = [kind for kind in self._index_of_kind if kind.buffer]
        with_records.sort(key=lambda kind: PLACES.index(kind.met_by_rays))
        self._records = {kind: table(str(kind.buffer), layout[str(kind.buffer)]) for kind in with_records}
        self.emissive: list[Instance] = []
        """The emissive instances, in the order of their rows."""
        self._index: dict[Instance, int] = {}
        self._others: dict[LightKind, dict[Light, None]] = {kind: {} for kind in with_records}
        self.blockers = Blockers()
        self._has_blockers = not isinstance(data, LightData)
        by_power = layout["light_leaves"]["by_power"]
        self.data = data if isinstance(data, LightData) else LightData(device, by_power, data)
        self._portal_maps = PortalMaps(device)
        self._edited: dict[Light, LightKind] = {}
        self._changed = True
        self._id_of: dict[Instance | Light, int] = {}
        self._last_id = 0
        self.ids: NDArray[np.uint32] = np.zeros(0, np.uint32)
        """For each row of `sources` a number that stays with the light and is never used again. Each change of the list
        makes a new array."""
        self._power_of: dict[Instance | Light, float] = {}
        self._powers_changed = True
        self.powers: NDArray[np.float64] = np.zeros(0)
        """Luminous flux of each row of `sources` in lumens, roughly. Each change makes a new array."""
        self.emitted: NDArray[np.float64] = np.zeros(0)
        """The same without portals, whose light is that of environments."""
        self.places: NDArray[np.float64] = np.zeros((0, 3))
        """The centers of the lights that aren't at infinity, the first rows, in meters. Each change makes a new
        array."""
        self._emissive_places = np.zeros((16, 2, 3))  # center, and half of the size of bounds
        self._clusters = ClusterBoxes()
        self._positions_changed = True
        self.positions: NDArray[np.float64] = np.zeros((0, 3))
        """A point of each row of `sources`, (N, 3) in meters, that moves with the light. Each change makes a new
        array."""

    @property
    def tables(self) -> tuple[Any, ...]:
        """All tables."""
        return self.sources, self.info, self.leaves.table, self.leaves.tree, *self._records.values()

    @property
    def others(self) -> dict[LightKind, list[Light]]:
        """The other lights of each kind, which follow in this order."""
        return {kind: list(lights) for kind, lights in self._others.items()}

    def id_of(self, light: Instance | Light) -> int | None:
        """The light's number in `ids`, if it is in the list."""
        return self._id_of.get(light)

    def records(self, kind: LightKind) -> NDArray[Any]:
        """The records of the lights of a kind."""
        records: NDArray[Any] = self._records[kind].records[: len(self._others[kind])]
        return records

    def index(self, instance: Instance) -> int | None:
        """An instance's row in `sources`, None if it is no light."""
        return self._index.get(instance)

    def set_emissive(
        self,
        instance: Instance,
        row: int,
        emission: Emission | None,
        area: float = 0.0,
        position: Position = ORIGIN,
        half_size: Position = ORIGIN,
    ) -> Instance | None:
        """Add or update the instance of that row, or remove it if its emission is None. Returns the instance whose
        index changed, if any.

        area: of the instance's surface in the world, in square meters, times its emissive texture's mean luminance.
        position: of the center of its bounds. half_size: half of the bounds' size.
        """
        index = self._index.get(instance)
        other, moved = self._clusters.set(instance, None if emission is None else emission.clusters)
        self._changed |= other
        self._positions_changed |= moved
        if emission is not None:
            self._set_power(instance, self._mesh_kind.power(instance, area))
            if index is None:
                index = self._index[instance] = len(self.emissive)
                self.emissive.append(instance)
                self.renew(instance)
            self.sources.reserve(index + 1)
            self._write_source(index, self._mesh_kind, row, emission)
            self._set_place(index, position, half_size)
            return None
        if index is None:
            return None
        self._changed = self._positions_changed = self._powers_changed = True
        del self._index[instance], self._id_of[instance], self._power_of[instance]
        last = self.emissive.pop()
        if last is instance:
            return None
        self.emissive[index] = last
        self._emissive_places[index] = self._emissive_places[len(self.emissive)]
        self._index[last] = index
        self.sources.records[index] = self.sources.records[len(self.emissive)]
        self.sources.mark([index])
        return last

    def _write_source(self, row: int, kind: LightKind, index: int, emission: Emission = ONE_PART) -> None:
        """Write a row without its probability."""
        record = self.sources.records[row]
        record["kind"], record["record_index"] = self._index_of_kind[kind], index
        record["part_count"] = emission.triangle_count
        record["parts"] = 0 if emission.choices is None else emission.choices.address
        record["halvings"] = 0 if emission.clusters is None else emission.clusters.halvings
        self.sources.mark([row])

    def renew(self, light: Instance | Light) -> None:
        """Give a light another id, because what was sampled on it, such as a triangle, has another meaning now."""
        self._last_id += 1
        self._id_of[light] = self._last_id
        self._changed = True

    def set_light(self, light: Light, present: bool) -> Instance | None:
        """Add, update or remove a light that is no instance; returns its body, if it has or had one."""
        own = kind_of(light)
        for kind, listed in self._others.items():
            if kind is not own or not present:
                listed.pop(light, None)
        if not present:
            for known in (self._id_of, self._power_of, self._edited):
                known.pop(light, None)
            self.data.set(light, None)
        elif light not in self._others[own]:
            self._others[own][light] = None
            self.renew(light)
        else:
            self._edited[light] = own
        self._changed |= not present
        if present and self.data.set(light, data_of(light)):
            self.renew(light)
        return self.blockers.update(light, present) if self._has_blockers else None

    def _set_place(self, index: int, position: Position, half_size: Position) -> None:
        if index >= len(self._emissive_places):
            self._emissive_places = np.concatenate([self._emissive_places, np.zeros((index + 1, 2, 3))])
        if self._emissive_places[index].tolist() != [[*position], [*half_size]]:
            self._emissive_places[index] = position, half_size
            self._positions_changed = True

    def _set_power(self, light: Instance | Light, power: float) -> None:
        known = self._power_of.get(light, 0.0)
        if not math.isclose(power, known, rel_tol=1e-5):  # turning an instance changes its area by rounding
            self._powers_changed = True
        if known == 0 < power and light in self._id_of:
            self.renew(light)
        self._power_of[light] = power

    def update(self, lit_area: Callable[[], float]) -> None:
        """Update the arrays and tables after changes. lit_area(): the scene's cross-section, roughly, in m^2."""
        others = [(kind, light) for kind, lights in self._others.items() for light in lights]
        if self._changed or any(isinstance(light, (Portal, EnvironmentLight)) for light in self._edited):
            for portal in self._portal_maps.follow(self._of(Portal), self._of(EnvironmentLight)):
                self._edited[portal] = kind_of(portal)
        self._update_edited(others, lit_area)
        if not (self._changed or self._powers_changed or self._positions_changed):
            return
        places = self._emissive_places[: len(self.emissive)]
        if self._changed or self._positions_changed:
            moving = [kind.position(light) for kind, light in others if kind.position]
            self.positions = np.concatenate([places[:, 0], np.reshape(moving, (-1, 3))])
            self._positions_changed = False
        chosen_otherwise = self._changed or self._powers_changed
        if chosen_otherwise:
            self._update_choices(others, lit_area)
        self._update_tree(places, others)

    def _of(self, source: type[Any]) -> list[Any]:
        return [light for lights in self._others.values() for light in lights if isinstance(light, source)]

    def _lit(self, kind: LightKind, lit_area: Callable[[], float]) -> float:
        """What the power of a light of a kind is computed with."""
        if kind.met_by_rays == AT_INFINITY:
            return lit_area()
        return sum(light.flux for light in self._of(EnvironmentLight)) if kind.met_by_rays == BEYOND else 0.0

    def _update_edited(self, others: list[tuple[LightKind, Light]], lit_area: Callable[[], float]) -> None:
        """Write the records of edited lights, unless all are about to be written."""
        follow = self._of(Portal) and any(isinstance(light, EnvironmentLight) for light in self._edited)
        for kind, light in others if follow else [(kind, light) for light, kind in self._edited.items()]:
            self._set_power(light, kind.power(light, self._lit(kind, lit_area)))
        if self._edited and not self._changed:
            index_of = {light: index for lights in self._others.values() for index, light in enumerate(lights)}
            for light, kind in self._edited.items():
                self._write_record(kind, index_of[light], light)
            self._positions_changed = True
        self._edited.clear()

    def _update_choices(self, others: list[tuple[LightKind, Light]], lit_area: Callable[[], float]) -> None:
        """Update what depends on the lights' number, order and powers."""
        if self._changed and others:
            for kind, light in others:
                self._set_power(light, kind.power(light, self._lit(kind, lit_area)))
        listed: list[Instance | Light] = [*self.emissive, *(light for _, light in others)]
        self.powers = np.fromiter((self._power_of[light] for light in listed), np.float64, len(listed))
        self._powers_changed = False
        if self._changed:
            self._changed = False
            self.ids = np.fromiter((self._id_of[light] for light in listed), np.uint32, len(listed))
            self._write_others(len(listed))
            sources = self.sources.records[: len(listed)]
            self.leaves.arrange([*map(self._clusters.of.get, listed)], sources["part_count"])  # type: ignore[arg-type]
            sources["first_leaf"] = self.leaves.firsts
            self.sources.mark(range(len(listed)))
            self._clusters.moved = dict.fromkeys(self._clusters.of)
        kinds = self.sources.records["kind"][: len(listed)]
        self.emitted = np.where(kinds == KIND_INDEX["portal"], 0.0, self.powers)
        self.leaves.choose(choice_weights_by_kind(self.powers, kinds))

    def _update_tree(self, places: NDArray[np.float64], others: list[tuple[LightKind, Light]]) -> None:
        """Update the tree over all lights but those at infinity."""
        info = self.info.records[0]
        finite = int(info["first_light_at_infinity"])
        solid = [kind.bounds(light) for kind, light in others if kind.bounds]
        emissive = places[:, :1] + places[:, 1:] * ((-1.0,), (1.0,))
        bounds = np.concatenate([emissive, np.reshape(solid, (-1, 2, 3))])
        self.places = bounds.mean(axis=1)
        boxes = {self._index[instance]: moved for instance, moved in self._clusters.take_moved()}
        chance = self.leaves.follow(self.ids[:finite], bounds, self.powers[:finite], boxes)
        part_counts = self.sources.records["part_count"][: len(self.powers)]
        info["part_count"] = min(int(part_counts.sum(dtype=np.int64)), NO_INDEX)
        info["tree_probability"], info["leaf_count"] = chance, self.leaves.count
        self.info.mark([0])

    def _write_others(self, light_count: int) -> None:
        """Write the rows behind the emissive instances, the records of their kinds, and `scene_info`."""
        self.sources.reserve(light_count)
        row = len(self.emissive)
        counts = {
            place: sum(len(lights) for kind, lights in self._others.items() if kind.met_by_rays == place)
            for place in (BEYOND, PASSED, AT_INFINITY)
        }
        first_at_infinity = light_count - counts[AT_INFINITY]
        info = self.info.records[0]
        for kind, lights in self._others.items():
            self._records[kind].reserve(len(lights))
            if kind.source is EnvironmentLight:
                info["first_environment"] = row
            for index, light in enumerate(lights):
                found = self.data.get(light)
                self._write_source(row, kind, index, found.emission if found else ONE_PART)
                self._write_record(kind, index, light)
                row += 1
        info["light_count"] = info["light_end"] = light_count
        info["first_light_at_infinity"] = first_at_infinity
        info["first_pass_through_light"] = first_at_infinity - counts[PASSED]
        info["first_portal"] = first_at_infinity - counts[PASSED] - counts[BEYOND]
        self.info.mark([0])

    def _write_record(self, kind: LightKind, index: int, light: Light) -> None:
        table, found = self._records[kind], self.data.get(light)
        own = self._portal_maps.get(light) or (found.record if found else {})
        for field, value in (kind.record(light) | own).items():
            table.records[index][field] = value
        table.mark([index])

    def destroy(self) -> None:
        """Free the tables."""
        for table in self.tables:
            table.destroy()
        self.data.destroy()
        self._portal_maps.destroy()
