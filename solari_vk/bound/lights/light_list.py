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

    origin: Scene.origin (3,), from which the coordinates in all tables and arrays count. data: for a list in the host's
    memory alone: the data of its maker, who has the blockers too, or what scenes share.
    """

    def __init__(
        self,
        device: Device,
        block_dtypes: dict[str, Any],
        origin: NDArray[np.float64],
        data: LightData | SharedBuffers | None = None,
    ) -> None:
        self._origin = origin
        table: MakeTable = partial(Table, device) if data is None else HostTable
        self.sources = table("light_sources", block_dtypes["light_sources"])
        self.info = table("scene_infos", block_dtypes["scene_infos"])
        self.info.records["origin"] = origin
        self.leaves = LightLeaves(table, block_dtypes)
        self._index_of_kind = {kind: index for index, kind in enumerate(light_kinds.LIGHT_KINDS)}
        self._mesh_kind = next(kind for kind in self._index_of_kind if kind.source is Instance)
        with_records = [kind for kind in self._index_of_kind if kind.buffer]
        with_records.sort(key=lambda kind: PLACES.index(kind.met_by_rays))
        self._records = {kind: table(str(kind.buffer), block_dtypes[str(kind.buffer)]) for kind in with_records}
        self.emissive: list[Instance] = []
        """The emissive instances, in the order of their rows."""
        self._index: dict[Instance, int] = {}
        self._analytic: dict[LightKind, dict[Light, None]] = {kind: {} for kind in with_records}
        self.blockers = Blockers()
        self._has_blockers = not isinstance(data, LightData)
        by_power = block_dtypes["light_leaves"]["by_power"]
        self.data = data if isinstance(data, LightData) else LightData(device, by_power, data)
        self._portal_maps = PortalMaps(device)
        # Arrays over the rows of `sources`. Each change makes a new array, so that readers see changes by identity.
        self.ids: NDArray[np.uint32] = np.zeros(0, np.uint32)
        """For each row a number that stays with the light and is never used again."""
        self.powers: NDArray[np.float64] = np.zeros(0)
        """Luminous flux of each row in lumens, roughly."""
        self.emitted: NDArray[np.float64] = np.zeros(0)
        """The same without portals, whose light is that of environments."""
        self.centers: NDArray[np.float64] = np.zeros((0, 3))
        """The centers of the lights that aren't at infinity, which are the first rows, in meters."""
        self.positions: NDArray[np.float64] = np.zeros((0, 3))
        """A point of each row, (N, 3) in meters, that moves with the light."""
        self._id_of: dict[Instance | Light, int] = {}
        self._last_id = 0
        self._power_of: dict[Instance | Light, float] = {}
        self._emissive_boxes = np.zeros((16, 2, 3))  # center, and half of the size of bounds
        self._clusters = ClusterBoxes()
        # What has changed since the latest `update`.
        self._edited: dict[Light, LightKind] = {}
        self._changed = True  # the lights, their order or what samples on them mean
        self._powers_changed = True
        self._positions_changed = True

    @property
    def tables(self) -> tuple[Any, ...]:
        """All tables."""
        return self.sources, self.info, self.leaves.table, self.leaves.tree, *self._records.values()

    @property
    def lights_by_kind(self) -> dict[LightKind, list[Light]]:
        """The lights of each kind that are no instances: behind the emissive instances, in this order."""
        return {kind: list(lights) for kind, lights in self._analytic.items()}

    def id_of(self, light: Instance | Light) -> int | None:
        """The light's number in `ids`, if it is in the list."""
        return self._id_of.get(light)

    def records(self, kind: LightKind) -> NDArray[Any]:
        """The records of the lights of a kind."""
        records: NDArray[Any] = self._records[kind].records[: len(self._analytic[kind])]
        return records

    def index(self, instance: Instance) -> int | None:
        """An instance's row in `sources`, None if it is no light."""
        return self._index.get(instance)

    # ---- changes of lights --------------------------------------------------------------------------

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
        is_changed, have_moved = self._clusters.set(instance, None if emission is None else emission.clusters)
        self._changed |= is_changed
        self._positions_changed |= have_moved
        if emission is None:
            return self._remove_emissive(instance)
        self._set_power(instance, self._mesh_kind.power(instance, area))
        index = self._index.get(instance)
        if index is None:
            index = len(self.emissive)
            self._index[instance] = index
            self.emissive.append(instance)
            self.renew_id(instance)
        self.sources.reserve(index + 1)
        self._write_source(index, self._mesh_kind, row, emission)
        self._set_box(index, position, half_size)
        return None

    def _remove_emissive(self, instance: Instance) -> Instance | None:
        """Remove an instance. Returns the last one if that takes its place, so that no other row moves."""
        index = self._index.pop(instance, None)
        if index is None:
            return None
        self._changed = True
        self._positions_changed = True
        self._powers_changed = True
        del self._id_of[instance], self._power_of[instance]
        last = self.emissive.pop()
        if last is instance:
            return None
        self.emissive[index] = last
        self._index[last] = index
        self._emissive_boxes[index] = self._emissive_boxes[len(self.emissive)]
        self.sources.records[index] = self.sources.records[len(self.emissive)]
        self.sources.mark([index])
        return last

    def set_light(self, light: Light, present: bool) -> Instance | None:
        """Add, update or remove a light that is no instance; returns its blocker, if it has or had one."""
        kind = kind_of(light)
        for other, listed in self._analytic.items():
            if other is not kind or not present:
                listed.pop(light, None)
        if not present:
            for of_lights in (self._id_of, self._power_of, self._edited):
                of_lights.pop(light, None)
            self.data.set(light, None)
            self._changed = True
        elif light not in self._analytic[kind]:
            self._analytic[kind][light] = None
            self.renew_id(light)
        else:
            self._edited[light] = kind
        if present and self.data.set(light, data_of(light)):
            self.renew_id(light)
        return self.blockers.place(light, present) if self._has_blockers else None

    def renew_id(self, light: Instance | Light) -> None:
        """Give a light another id, because what was sampled on it, such as a triangle, has another meaning now."""
        self._last_id += 1
        self._id_of[light] = self._last_id
        self._changed = True

    def _set_box(self, index: int, position: Position, half_size: Position) -> None:
        if index >= len(self._emissive_boxes):
            self._emissive_boxes = np.concatenate([self._emissive_boxes, np.zeros((index + 1, 2, 3))])
        if self._emissive_boxes[index].tolist() != [[*position], [*half_size]]:
            self._emissive_boxes[index] = position, half_size
            self._positions_changed = True

    def _set_power(self, light: Instance | Light, power: float) -> None:
        known = self._power_of.get(light, 0.0)
        if not math.isclose(power, known, rel_tol=1e-5):  # turning an instance changes its area by rounding
            self._powers_changed = True
        # A light that was dark was never sampled: what frames remember of it is of no use.
        if known == 0 < power and light in self._id_of:
            self.renew_id(light)
        self._power_of[light] = power

    # ---- an update, step by step ---------------------------------------------------------------------

    def update(self, lit_area: Callable[[], float]) -> None:
        """Update the arrays and tables after changes. lit_area(): the scene's cross-section, roughly, in m^2."""
        analytic_lights = [(kind, light) for kind, lights in self._analytic.items() for light in lights]
        self._update_portals()
        self._update_edited(analytic_lights, lit_area)
        if not (self._changed or self._powers_changed or self._positions_changed):
            return
        boxes = self._emissive_boxes[: len(self.emissive)]
        if self._changed or self._positions_changed:
            points = [self._point_of(kind, light) for kind, light in analytic_lights if kind.position]
            self.positions = np.concatenate([boxes[:, 0], np.reshape(points, (-1, 3))])
            self._positions_changed = False
        if self._changed or self._powers_changed:
            self._update_rows(analytic_lights, lit_area)
        self._update_tree(boxes, analytic_lights)

    def _update_portals(self) -> None:
        """Have the maps of portals show the environments, whose light comes through them."""
        are_edited = any(isinstance(light, (Portal, EnvironmentLight)) for light in self._edited)
        if self._changed or are_edited:
            for portal in self._portal_maps.make(self._lights_of(Portal), self._lights_of(EnvironmentLight)):
                self._edited[portal] = kind_of(portal)

    def _lights_of(self, source: type[Any]) -> list[Any]:
        return [light for lights in self._analytic.values() for light in lights if isinstance(light, source)]

    def _power(self, kind: LightKind, light: Light, lit_area: Callable[[], float]) -> float:
        """The power of a light, as its kind computes it from what it lights, or of a portal what it lets through."""
        if kind.met_by_rays == AT_INFINITY:
            return kind.power(light, lit_area())
        flux = 0.0
        if kind.met_by_rays == BEYOND:
            flux = sum(environment.flux for environment in self._lights_of(EnvironmentLight))
        return kind.power(light, flux)

    def _update_edited(self, analytic_lights: list[tuple[LightKind, Light]], lit_area: Callable[[], float]) -> None:
        """Write the records of edited lights, unless all are about to be written."""
        edited = [(kind, light) for light, kind in self._edited.items()]
        # An environment that was edited changes what portals let through.
        through_portals = any(isinstance(light, EnvironmentLight) for light in self._edited) and self._lights_of(Portal)
        for kind, light in analytic_lights if through_portals else edited:
            self._set_power(light, self._power(kind, light, lit_area))
        if edited and not self._changed:
            index_of = {light: index for lights in self._analytic.values() for index, light in enumerate(lights)}
            for kind, light in edited:
                self._write_record(kind, index_of[light], light)
            self._positions_changed = True
        self._edited.clear()

    def _update_rows(self, analytic_lights: list[tuple[LightKind, Light]], lit_area: Callable[[], float]) -> None:
        """Update what depends on the lights' number, order and powers."""
        if self._changed:
            for kind, light in analytic_lights:
                self._set_power(light, self._power(kind, light, lit_area))
        listed: list[Instance | Light] = [*self.emissive, *(light for _, light in analytic_lights)]
        self.powers = np.fromiter((self._power_of[light] for light in listed), np.float64, len(listed))
        self._powers_changed = False
        if self._changed:
            self._changed = False
            self.ids = np.fromiter((self._id_of[light] for light in listed), np.uint32, len(listed))
            self._write_analytic(len(listed))
            sources = self.sources.records[: len(listed)]
            clusters = [self._clusters.of.get(light) for light in listed]  # type: ignore[arg-type]
            self.leaves.arrange(clusters, sources["part_count"])
            sources["first_leaf"] = self.leaves.firsts
            self.sources.mark(range(len(listed)))
            # The tree has the boxes of all clusters at other places now.
            self._clusters.moved = dict.fromkeys(self._clusters.of)
        kinds = self.sources.records["kind"][: len(listed)]
        self.emitted = np.where(kinds == KIND_INDEX["portal"], 0.0, self.powers)
        self.leaves.choose(choice_weights_by_kind(self.powers, kinds))

    def _update_tree(self, emissive_boxes: NDArray[np.float64], analytic_lights: list[tuple[LightKind, Light]]) -> None:
        """Update the tree over all lights but those at infinity."""
        info = self.info.records[0]
        finite = int(info["first_light_at_infinity"])
        has_portals = bool(info["first_portal"] != info["first_pass_through_light"])
        of_analytic = [kind.bounds(light) - self._origin for kind, light in analytic_lights if kind.bounds]
        # A box as its center and half its size becomes one as its min and max.
        emissive = emissive_boxes[:, :1] + emissive_boxes[:, 1:] * ((-1.0,), (1.0,))
        bounds = np.concatenate([emissive, np.reshape(of_analytic, (-1, 2, 3))])
        self.centers = bounds.mean(axis=1)
        moved = {self._index[instance]: boxes - self._origin for instance, boxes in self._clusters.pop_moved()}
        chance = self.leaves.follow(self.ids[:finite], bounds, self.powers[:finite], moved, has_portals)
        part_counts = self.sources.records["part_count"][: len(self.powers)]
        info["part_count"] = min(int(part_counts.sum(dtype=np.int64)), NO_INDEX)
        info["tree_probability"] = chance
        info["leaf_count"] = self.leaves.count
        self.info.mark([0])

    def _point_of(self, kind: LightKind, light: Light) -> NDArray[np.float64]:
        assert kind.position is not None
        # Points of lights at infinity are directions.
        return kind.position(light) - self._origin if kind.places else kind.position(light)

    # ---- records ------------------------------------------------------------------------------------

    def _write_source(self, row: int, kind: LightKind, index: int, emission: Emission = ONE_PART) -> None:
        """Write a row without its probability."""
        record = self.sources.records[row]
        record["kind"] = self._index_of_kind[kind]
        record["record_index"] = index
        record["part_count"] = emission.triangle_count
        record["parts"] = 0 if emission.choices is None else emission.choices.address
        record["halvings"] = 0 if emission.clusters is None else emission.clusters.halvings
        self.sources.mark([row])

    def _write_analytic(self, light_count: int) -> None:
        """Write the rows behind the emissive instances, the records of their kinds, and `scene_info`."""
        self.sources.reserve(light_count)
        row = len(self.emissive)
        counts = dict.fromkeys(PLACES, 0)
        info = self.info.records[0]
        for kind, lights in self._analytic.items():
            counts[kind.met_by_rays] += len(lights)
            self._records[kind].reserve(len(lights))
            if kind.source is EnvironmentLight:
                info["first_environment"] = row
            for index, light in enumerate(lights):
                data = self.data.get(light)
                self._write_source(row, kind, index, data.emission if data else ONE_PART)
                self._write_record(kind, index, light)
                row += 1
        # The order of PLACES puts lights at infinity last, and before them those that rays pass.
        first_at_infinity = light_count - counts[AT_INFINITY]
        info["light_count"] = light_count
        info["light_end"] = light_count
        info["first_light_at_infinity"] = first_at_infinity
        info["first_pass_through_light"] = first_at_infinity - counts[PASSED]
        info["first_portal"] = first_at_infinity - counts[PASSED] - counts[BEYOND]
        self.info.mark([0])

    def _write_record(self, kind: LightKind, index: int, light: Light) -> None:
        table = self._records[kind]
        data = self.data.get(light)
        of_data = self._portal_maps.get(light) or (data.record if data else {})
        values: dict[str, Any] = {**kind.record(light), **of_data}
        for field in kind.places:
            values[field] = values[field] - self._origin
        for field, value in values.items():
            table.records[index][field] = value
        table.mark([index])

    def destroy(self) -> None:
        """Free the tables."""
        for table in self.tables:
            table.destroy()
        self.data.destroy()
        self._portal_maps.destroy()
