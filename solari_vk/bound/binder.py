"""Keeps the resources of descriptor set 0 equal to a scene: uploads what changed, and rebuilds the TLAS.

The scene tells the binder which objects have changed. `update` turns changes into rows of tables, uploads and builds of
acceleration structures, which the device executes just before the next submission. Uploads and builds are proportional
to the change, not to the scene, but for lights: bound/lights/light_list.py says which changes concern all of them.
"""

from __future__ import annotations

import weakref
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.assets import Assets
from solari_vk.bound.lights.light_list import LightList
from solari_vk.bound.lights.light_tree import LightTree
from solari_vk.bound.scene_rows import SceneRows
from solari_vk.bound.table import Table
from solari_vk.bound.traced_instances import TracedInstances
from solari_vk.gpu.device.cuda_input import Taken
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.stopwatch import Stopwatch
from solari_vk.scene.model import Mesh, Scene
from solari_vk.scene.observed import Observable
from solari_vk.scene.on_device import OnDevice


class SceneBinder(SceneRows):
    """A scene on a device, which several renderers may share. `resources` are those of descriptor set 0, by name.

    `version` increases when a resource was replaced or the scene got a new feature.
    """

    traced: TracedInstances

    def __init__(self, device: Device, scene: Scene) -> None:
        self.version = 0
        self._device = device
        with device.undone_on_error():
            assets = Assets(device, self)
            super().__init__(
                device, scene, assets, partial(Table, device), TracedInstances(device), LightList(device, assets.layout)
            )
        self._tables = (*assets.tables, self.instance_table, *self.lights.tables, self.traced.table)
        self._unbound = (self.traced.table, *self._geometry.posed.tables)  # no frame's shader has them
        self._previous_users: set[object] = set()
        self._up_to_date = weakref.WeakSet[Any]()  # who has used the scene since its latest change
        self._first = True

    @property
    def resources(self) -> dict[str, Any]:
        """The resources of descriptor set 0 by their names in GLSL."""
        return {table.name: table.buffer for table in self._tables if table not in self._unbound} | {
            "tlas": self.traced.tlas,
            "previous_tlas": self.traced.previous or self.traced.tlas,
            "texture_images": self._textures.bound,
        }

    @property
    def features(self) -> frozenset[str]:
        """The specialization constants that are true in the scene's pipelines, as of the latest `update`."""
        return self._features.constants

    @property
    def dark_scenes(self) -> list[Scene]:
        """The scene, if it has no light, as of the latest `update`."""
        return [] if len(self.lights.ids) else [self.scene]

    @property
    def triangle_orders(self) -> dict[int, NDArray[np.int64]]:
        """For each row of `meshes` in use: the mesh's triangle of each uploaded triangle."""
        return self.assets.triangle_orders

    def time_poses(self) -> Stopwatch:
        """Have the device time the vertices and acceleration structures of poses from now on."""
        return self._geometry.posed.time_poses()

    def keep_previous_tlas(self, renderer: object, needed: bool) -> None:
        """Say whether a renderer needs the TLAS of the previous frame as `previous_tlas`, from the next update on.

        While none does, that is `tlas`; else a copy, made in each frame whose instances moved and in the next one.
        """
        (self._previous_users.add if needed else self._previous_users.discard)(renderer)

    def update(self, user: Any = None) -> None:
        """Apply all changes since the latest call. Raises SolariError for a scene that is too large.

        user: who is about to render a frame, if anybody is. The previous positions of poses are those of this user's
        latest frame. `previous_tlas` is from before the latest change until a user that has used the changed scene is
        about to do so again.
        """
        self._device.check_open()
        self.assets.check_given()
        self.version += self.traced.keep_previous(bool(self._previous_users))
        if not self._changed and not self._first:
            self.assets.show(user)
            if (self if user is None else user) in self._up_to_date:
                self.traced.rebuild()
            self._note_use(user)
            return
        self._first = False
        self._up_to_date = weakref.WeakSet()
        features = self.features
        try:
            self.version += self.assets.update([self], self.revision + 1, user)
            self.version += self.features != features
            self._upload()
        except BaseException:
            self.undo()  # the next update tries again, and uploads everything
            self.version += 1  # buffers may be other ones by now
            for table in self._tables:
                table.mark_all()
            self.traced.mark_all()
            raise
        self.settle()
        self._note_use(user)

    def _note_use(self, user: Any) -> None:
        self._up_to_date.add(self if user is None else user)
        self._geometry.posed.note_seen(user, self.revision)

    def take_all(self, values: Any) -> Taken | None:
        """As of `Assets`."""
        return self.assets.take_all(values)

    def take(self, item: OnDevice, fields: Mapping[str, Any]) -> dict[str, Taken] | None:
        """What tensors give an object, as of `Assets.take`; None for a lamp's, which the host needs."""
        return None if self.lamps.emissions.use(item) else self.assets.take(item, fields)

    def note_feature(self, item: Observable | LightTree) -> None:
        """Take note of what another world has: in place of an object of the scene, or as its lights."""
        before = self.features
        self._features.note(item)
        self.version += self.features != before

    def meet_once(self, mesh: Mesh) -> bool:
        """As `Geometry.meet_once`; another `update` is needed if it returns True."""
        if new := self._geometry.meet_once(mesh):
            self.note(mesh)
        return new

    # ---- from records to the device -----------------------------------------------------------------

    def _upload(self) -> None:
        """Copy the tables' changes and build the TLAS, before the next submission."""
        if self.traced.update():
            self.version += 1
        self.version += self.assets.upload(self._tables)
        self._geometry.posed.submit()
        self.traced.rebuild(self._geometry.structures.kept)
        self._geometry.structures.kept = True

    def destroy(self) -> None:
        """Stop watching the scene and free everything."""
        super().destroy()
        self.assets.destroy()
        self.traced.destroy()
