"""The worlds of a batch that shows several scenes: each has the instances and lights of its own scene."""

from __future__ import annotations

from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.batch.light_tables import LightTables
from solari_vk.batch.world_changes import Known
from solari_vk.batch.world_tables import WorldTables
from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.constants import NO_INDEX
from solari_vk.gpu.acceleration.tlas import INSTANCE_DTYPE
from solari_vk.gpu.device.device import Device


class SceneWorlds(WorldTables):
    """The worlds of the scenes of a binder."""

    shows_scenes = True

    def __init__(self, device: Device, binder: SceneBinder) -> None:
        super().__init__(device, len(binder.worlds))
        self._binder = binder
        self._lit = LightTables(device, binder.lights, self.count)
        self._seen = -1  # the revision of the scenes that was written
        self._sizes: tuple[int, ...] = ()
        self._instances: NDArray[Any] = np.zeros(0)
        self._traced: NDArray[Any] = np.zeros(0)
        self._written: list[int] = []  # the revision of each world's scene

    @property
    def transforms(self) -> NoReturn:
        raise _refusal("transforms", "the instances")

    @property
    def materials(self) -> NoReturn:
        raise _refusal("world_materials", "the instances")

    @property
    def lights(self) -> NoReturn:
        raise _refusal("world_lights", "the lights")

    @property
    def rows(self) -> int:
        return self._binder.instance_capacity

    @property
    def known_lights(self) -> list[Known]:
        return self._lit.known

    @property
    def blended_changes(self) -> NDArray[np.int64]:
        return np.array([scene.blended_changes for scene in self._binder.worlds])

    def update(self) -> int:
        if self._seen != self._binder.revision:
            again, self._seen = self._seen < 0, -1  # until all is written
            scenes = self._binder.worlds
            shown = [(id(scene), sum(table.revision for table in scene.lights.tables)) for scene in scenes]
            lists = {key: scene.lights for key, scene in zip(shown, scenes, strict=True)}
            if self._lit.show(lists, shown, self.rows) or again:
                for name, table in self._lit.tables.items():
                    self._upload(name, table)
            self._write()
            self._seen = self._binder.revision
        return self.version

    def _write(self) -> None:
        scenes, rows = self._binder.worlds, self.rows
        light_rows = self._lit.tables["light_sources"].shape[1]
        counts = tuple(scene.traced.count for scene in scenes)
        if self._sizes != (sizes := (rows, light_rows, max(counts))):
            dtype = scenes[0].instance_table.records.dtype
            self._check_room(f"{len(set(scenes)):,} scenes", dtype.itemsize)
            self._instances = np.zeros((self.count, rows), dtype)
            self._traced = np.zeros((self.count, max(counts)), INSTANCE_DTYPE)
            self._sizes, self._written = sizes, [-1] * self.count
        for world, (scene, count) in enumerate(zip(scenes, counts, strict=True)):
            if self._written[world] == scene.revision:
                continue
            own = scene.instance_table.records
            self._instances[world, : len(own)] = own
            lights = self._instances["light_index"][world]
            lights[lights != NO_INDEX] += world * light_rows
            self._traced[world, :count] = scene.traced.table.records[:count]
            self._traced["custom_index_and_mask"][world, :count] += world * rows
            self._written[world] = scene.revision
        self._upload("instances", self._instances)
        self._prepare(self._traced, counts)
        self._build()


def _refusal(what: str, changed: str) -> SolariError:
    return SolariError(
        f"Batch.{what} is for the worlds of one scene, and this batch has a list of scenes: change "
        f"{changed} of a world's scene, or make the batch of one scene with worlds="
    )
