"""The tables of the lights of worlds: those of light_list.py, one world's rows after the other's.

Each world has as many rows of a table as the world that needs most. Worlds with the same lights share one LightList in
the host's memory.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.batch.world_changes import Known
from solari_vk.bound.constants import NO_INDEX
from solari_vk.bound.lights.light_list import LightList
from solari_vk.gpu.device.device import Device
from solari_vk.scene.model import Instance


class Listed(NamedTuple):
    """The lights of some worlds. lamps: in the list's order, and the stand-ins for them that are in the list."""

    lights: LightList
    lamps: list[Instance]
    stand_ins: list[Instance]
    known: Known


class LightTables:
    """The light tables of a batch's worlds, in the host's memory. scene_lights: a list with their layout."""

    def __init__(self, device: Device, scene_lights: LightList, worlds: int) -> None:
        self._worlds, self._device, self._scene_lights = worlds, device, scene_lights
        self._layout = {table.name: table.records.dtype for table in scene_lights.tables}
        self.tables: dict[str, NDArray[Any]] = {}
        """By the names in GLSL (worlds, rows); none while all worlds share the scene's lights."""
        self.known: list[Known] = []
        """For each world, or one for all that share the scene's lights. What has changed is another object."""
        self.lamp_rows: dict[Instance, NDArray[np.uint32]] = {}
        """The rows in `light_sources` (worlds,) of instances that emit light in some world, NO_INDEX elsewhere."""
        self._lists: dict[Any, Listed] = {}
        self._shown: list[Any] = []  # the key of each world's list
        self._rows = 0  # of a world in `instances`

    def show(self, lists: Mapping[Any, LightList], shown: list[Any], rows: int) -> bool:
        """Have worlds (W,) show lists by their keys, which change with a list. rows: of a world in `instances`. Returns
        whether tables have changed."""
        self._lists = {
            key: self._lists.get(key) or Listed(lights, lights.emissive.copy(), [], Known.of(lights))
            for key, lights in lists.items()
        }
        return self._write(shown, [], rows)

    def _write(self, shown: list[Any], lamps: list[Instance], rows: int) -> bool:
        sizes = dict.fromkeys(self._layout, 1)
        for listed in self._lists.values():
            for name, count in row_counts(listed.lights).items():
                sizes[name] = max(sizes[name], count)
        if rows != self._rows:
            self._rows, self._shown = rows, []
        if {name: table.shape[1] for name, table in self.tables.items()} != sizes:
            limit = self._device.properties.limits.maxStorageBufferRange
            for name, size in sizes.items():
                most = limit // (size * self._layout[name].itemsize)
                if self._worlds > most:
                    raise SolariError(
                        f"Batch: {self._worlds:,} worlds with lights of their own, of which one has "
                        f"{size:,} rows of {name}: this device holds at most {most:,}: share the worlds "
                        "among several batches"
                    )
            self.tables = {name: np.zeros((self._worlds, size), self._layout[name]) for name, size in sizes.items()}
            self._shown = []
        if not self._shown:
            self._shown, self.known = [None] * self._worlds, [Known.of(self._scene_lights)] * self._worlds
        self.lamp_rows = {lamp: self.lamp_rows.get(lamp, np.full(self._worlds, NO_INDEX, np.uint32)) for lamp in lamps}
        changed: dict[Any, list[int]] = {}
        for world, (key, old) in enumerate(zip(shown, self._shown, strict=True)):
            if key != old:
                changed.setdefault(key, []).append(world)
                self.known[world] = self._lists[key].known
        for key, worlds in changed.items():
            self._write_list(np.array(worlds), self._lists[key], rows)
        self._shown = shown
        return bool(changed)

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
        info["first_portal_record"] = first["portals"]
        info["first_leaf"], info["light_root"] = first["light_leaves"], first["light_tree"]
        put("scene_infos", info)
        for lamp, of_lamp in self.lamp_rows.items():
            place = listed.lamps.index(lamp) if lamp in listed.lamps else None
            of_lamp[worlds] = NO_INDEX if place is None else first["light_sources"][:, 0] + place


def row_counts(made: LightList) -> dict[str, int]:
    """The rows of each table."""
    counts = {str(kind.buffer): len(made.records(kind)) for kind in made.others}
    return counts | {
        "light_sources": len(made.ids),
        "light_leaves": made.leaves.count,
        "light_tree": made.leaves.node_count,
    }
