"""Several scenes on a device for a batch whose worlds show them: they share meshes, textures and materials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.assets import Assets
from solari_vk.bound.lights.light_list import LightList
from solari_vk.bound.lights.own_buffers import SharedBuffers
from solari_vk.bound.material_table import MaterialTable
from solari_vk.bound.scene_rows import SceneRows
from solari_vk.bound.table import HostTable
from solari_vk.bound.traced_instances import TracedRecords
from solari_vk.gpu.device.cuda_input import Taken
from solari_vk.gpu.device.device import Device
from solari_vk.scene.model import Camera, Instance, Scene
from solari_vk.scene.observed import Observable
from solari_vk.scene.on_device import OnDevice


class ScenesBinder:
    """Scenes on a device, with what frames of a batch use of a `SceneBinder`. scenes: of each world, in which one may
    stand several times. Instances and lights are in the host's memory, from which `SceneWorlds` takes them.

    `version` increases when a resource was replaced or a scene got a new feature, `revision` with each change.
    """

    def __init__(self, device: Device, scenes: Sequence[Scene]) -> None:
        self.version = self.revision = 0
        self._device = device
        with device.undone_on_error():
            self.assets = Assets(device, self)
            shared = SharedBuffers()
            each = {
                scene: SceneRows(
                    device,
                    scene,
                    self.assets,
                    HostTable,
                    TracedRecords(),
                    LightList(device, self.assets.layout, shared),
                )
                for scene in dict.fromkeys(scenes)
            }
        self.worlds = [each[scene] for scene in scenes]
        """The rows of each world's scene."""
        self._scenes = list(each.values())
        self._features: frozenset[str] = frozenset()

    def note(self, changed: Observable) -> None:
        """Tell the scenes that use an asset that it was edited; or take note of the lens of a camera."""
        if isinstance(changed, Camera):
            self.assets.features.note(changed)
            return
        users = self.assets.users(changed)
        for scene in self._scenes:
            if scene.uses(users):
                scene.note(changed)

    def take_all(self, values: Any) -> Taken | None:
        """As of `Assets`."""
        return self.assets.take_all(values)

    def take(self, item: OnDevice, fields: Mapping[str, Any]) -> dict[str, Taken] | None:
        """As of `SceneBinder`."""
        if any(scene.lamps.emissions.use(item) for scene in self._scenes):
            return None
        return self.assets.take(item, fields)

    @property
    def scene(self) -> Scene:
        """The first scene."""
        return self.worlds[0].scene

    @property
    def lights(self) -> LightList:
        """Those of the first scene."""
        return self.worlds[0].lights

    @property
    def dark_scenes(self) -> list[Scene]:
        """The scenes that have no light, as of the latest `update`."""
        return [scene.scene for scene in self._scenes if not len(scene.lights.ids)]

    @property
    def resources(self) -> dict[str, Any]:
        """The resources of descriptor set 0 that scenes share, by their names in GLSL."""
        posed = self.assets.geometry.posed.tables
        buffers = {table.name: table.buffer for table in self.assets.tables if table not in posed}
        return buffers | {"texture_images": self.assets.textures.bound}

    @property
    def features(self) -> frozenset[str]:
        """The specialization constants that are true because of one of the scenes."""
        return self.assets.features.constants

    @property
    def instances(self) -> dict[int, dict[int, Instance]]:
        """For each world its instances and bodies of lights by their rows."""
        return {world: scene.instances for world, scene in enumerate(self.worlds)}

    @property
    def instance_capacity(self) -> int:
        """The number of rows of a world in the shaders' `instances`."""
        return max(scene.instance_capacity for scene in self._scenes)

    @property
    def materials(self) -> MaterialTable:
        """The materials of all scenes."""
        return self.assets.materials

    @property
    def triangle_orders(self) -> dict[int, NDArray[np.int64]]:
        """As of `SceneBinder`."""
        return self.assets.triangle_orders

    def keep_previous_tlas(self, renderer: object, needed: bool) -> None:
        """Nothing: worlds have no structures of previous frames."""

    def update(self, user: Any = None) -> None:
        """Apply all changes since the latest call, as `SceneBinder.update`."""
        self._device.check_open()
        assets = self.assets
        posed = assets.geometry.posed
        assets.check_given()
        if self.revision and not any(scene.changed for scene in self._scenes):
            assets.show(user)
        else:
            try:
                self.version += assets.update(self._scenes, self.revision + 1, user)
                for scene in self._scenes:
                    scene.traced.sort()
                    info = scene.lights.info
                    if info.records["without"][0] != scene.without:
                        info.records["without"][0] = scene.without
                        info.mark([0])
                self.version += assets.upload(assets.tables)
                posed.submit()
            except BaseException:
                for scene in self._scenes:
                    scene.undo()  # the next update tries again
                self.version += 1  # buffers may be other ones by now
                for table in assets.tables:
                    table.mark_all()
                raise
            for scene in self._scenes:
                scene.settle()
            self.revision += 1
        self.version += self.features != self._features
        self._features = self.features
        posed.note_seen(user, self.revision)

    def destroy(self) -> None:
        """Stop watching the scenes and free everything."""
        for scene in self._scenes:
            scene.destroy()
        self.assets.destroy()
