"""Keeps the resources of descriptor set 0 equal to a scene, or to several scenes that share their assets.

Scenes tell the binder which objects have changed. `update` turns changes into rows of tables, uploads and builds of
acceleration structures, which the device executes just before the next submission. They are proportional to the change,
not to the scene, with two exceptions: the TLAS is always built as a whole, and some changes concern all lights
(bound/lights/light_list.py says which).

A world is what one view of a batch sees. One scene has its records in tables on the device, which are its only world.
Of several scenes the records stay on the host, from where batch/worlds.py copies them to the rows of each world.
"""

from __future__ import annotations

import weakref
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.assets import Assets
from solari_vk.bound.lights.light_data import SharedBuffers
from solari_vk.bound.lights.light_list import LightList
from solari_vk.bound.lights.light_tree import LightChoice
from solari_vk.bound.material_table import MaterialTable
from solari_vk.bound.scene_records import SceneRecords
from solari_vk.bound.table import HostTable, Table
from solari_vk.bound.traced_instances import SceneTlas
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.stopwatch import Stopwatch
from solari_vk.gpu.tensors.imports import DeviceTensor
from solari_vk.gpu.tensors.port import TensorPort
from solari_vk.scene.model import Camera, Instance, Mesh, Scene
from solari_vk.scene.observable import Observable
from solari_vk.scene.tensor_fields import TensorFields


class SceneBinder:
    """A scene on a device, which several renderers may share. `resources` are those of descriptor set 0, by name.

    scene: or the scene of each world of a batch, in which a scene may stand several times.

    """

    def __init__(self, device: Device, scene: Scene | Sequence[Scene]) -> None:
        self.bindings_version = 0
        """Counts the changes after which frames must bind the resources again: other buffers, or a new feature."""
        self.scene_revision = 0
        """Counts the updates that applied edits of a scene."""
        self.has_many_scenes = not isinstance(scene, Scene)
        """Whether each world has a scene of its own: the binder was made of a list."""
        self.device = device
        scenes = [scene] if isinstance(scene, Scene) else list(scene)
        self.tlas: SceneTlas | None = None
        """The structure that rays traverse, of one scene."""
        with device.undone_on_error():
            self.assets = Assets(device, self)
            self._all_records = self._make_records(dict.fromkeys(scenes))
            if not self.has_many_scenes:
                geometry = self.assets.geometry
                self.tlas = SceneTlas(device, self._all_records[0].traced, geometry.orders)
                geometry.structures.builds_at_once = self._all_records[0].traced.flat is None
        each = {records.scene: records for records in self._all_records}
        self.listed_records = [each[one] for one in scenes]
        """The records of each scene of the list, in its order; a scene that stands there twice has its records
        twice."""
        self._tables = self._device_tables()
        self._previous_users: set[object] = set()  # renderers that need `previous_tlas`
        self._up_to_date = weakref.WeakSet[Any]()  # who has used the scene since its latest change
        self._is_current = False  # whether the device has all changes as of the latest `update`
        self._counted_features: frozenset[str] = frozenset()  # that `version` knows of

    def _make_records(self, scenes: Mapping[Scene, None]) -> list[SceneRecords]:
        block_dtypes = self.assets.block_dtypes
        table: Any = partial(Table, self.device)
        shared = None
        if self.has_many_scenes:
            table = HostTable
            shared = SharedBuffers()
        records = []
        for scene in scenes:
            origin = scene.origin
            lights = LightList(self.device, block_dtypes, origin, shared)
            records.append(SceneRecords(self.device, scene, self.assets, table, lights, origin))
        return records

    def _device_tables(self) -> tuple[Table, ...]:
        if self.has_many_scenes:
            return self.assets.tables
        records = self.records
        return (*self.assets.tables, records.instance_table, *records.lights.tables, records.traced.table)

    # ---- what others read ---------------------------------------------------------------------------

    @property
    def records(self) -> SceneRecords:
        """The instances and lights of the first scene."""
        return self._all_records[0]

    @property
    def origin(self) -> NDArray[np.float64]:
        """From where the coordinates on the device count, (3,): the first scene's `Scene.origin`, as it was when the
        binder was made."""
        return self.records.origin

    @property
    def scene(self) -> Scene:
        """The first scene."""
        return self.records.scene

    @property
    def lights(self) -> LightList:
        """The lights of the first scene."""
        return self.records.lights

    @property
    def instances(self) -> dict[int, Instance]:
        """The instances and blockers of lights of the first scene by their rows, the shaders' indices, as of the latest
        `update`."""
        return self.records.instances

    @property
    def edit_counts(self) -> NDArray[np.int64]:
        """The numbers of edits of the first scene so far, `SceneRecords.edit_counts`."""
        return np.array(self.records.edit_counts)

    @property
    def instance_capacity(self) -> int:
        """The number of rows of a world in the shaders' `instances`."""
        return max(records.instance_capacity for records in self._all_records)

    @property
    def tensors(self) -> TensorPort:
        """What accepts tensors for the assets of the scenes."""
        return self.assets.tensors

    @property
    def materials(self) -> MaterialTable:
        """The materials of all scenes."""
        return self.assets.materials

    @property
    def resources(self) -> dict[str, Any]:
        """The resources of descriptor set 0 by their names in GLSL; of several scenes those that they share."""
        # No shader of a frame has the tables of poses, nor the records that the TLAS is built of.
        unbound = (*self.assets.geometry.posed.tables, self.records.traced.table)
        found: dict[str, Any] = {table.name: table.buffer for table in self._tables if table not in unbound}
        if self.tlas is not None:
            found |= self.tlas.resources
        return found | self.assets.textures.resources

    @property
    def features(self) -> frozenset[str]:
        """The specialization constants that are true in the scenes' pipelines, as of the latest `update`."""
        return self.assets.features.constants

    @property
    def dark_scenes(self) -> list[Scene]:
        """The scenes that are black for lack of light, as of the latest `update`."""
        return [
            records.scene
            for records in self._all_records
            if not len(records.lights.ids) and _needs_light(records.scene)
        ]

    @property
    def triangle_orders(self) -> dict[int, NDArray[np.int64]]:
        """For each row of `meshes` in use: the mesh's triangle of each uploaded triangle."""
        return self.assets.triangle_orders

    def time_poses(self) -> Stopwatch:
        """Have the device time the vertices and acceleration structures of poses from now on."""
        return self.assets.geometry.posed.time_poses()

    # ---- what others say ----------------------------------------------------------------------------

    def mark_changed(self, changed: Observable) -> None:
        """Tell the scenes that use an asset that it was edited. A camera with a lens has the next `update` add the
        feature of lenses to the shaders."""
        # An asset of one scene may also be used by worlds of a batch alone, so that no instance of the scene has it.
        if not self.has_many_scenes or isinstance(changed, Camera):
            self.records.mark_changed(changed)
            return
        users = self.assets.users(changed)
        for records in self._all_records:
            if records.has_any(users):
                records.mark_changed(changed)

    def accept_tensor(self, values: Any) -> DeviceTensor | None:
        """What `Assets.accept_tensor` returns."""
        return self.assets.accept_tensor(values)

    def accept_tensors(self, item: TensorFields, fields: Mapping[str, Any]) -> dict[str, DeviceTensor] | None:
        """What `Assets.accept_tensors` returns; None for what emits light, which the host must know."""
        if any(records.emissions.depend_on(item) for records in self._all_records):
            return None
        return self.assets.accept_tensors(item, fields)

    def add_feature(self, item: Observable | LightChoice) -> None:
        """Have shaders with what a world of a batch has in place of an object of the scene, or as its lights."""
        self.assets.features.add_of(item)
        self._count_features()

    def use_scale(self, instance: Instance, scale: float) -> None:
        """Have shaders with large instances if a world of a batch shows an instance as one, at a scale."""
        self.records.use_scale(instance, scale)
        self._count_features()

    def use_no_duplicate_any_hit(self, mesh: Mesh) -> bool:
        """As `Geometry.use_no_duplicate_any_hit`; another `update` is needed if it returns True."""
        is_new = self.assets.geometry.use_no_duplicate_any_hit(mesh)
        if is_new:
            self.mark_changed(mesh)
        return is_new

    def keep_previous_tlas(self, renderer: object, needed: bool) -> None:
        """Say whether a renderer needs the TLAS of the previous frame as `previous_tlas`, from the next update on.

        While none does, that is `tlas`; else a copy, made in each frame whose instances moved and in the next one.
        Worlds of several scenes have none.
        """
        if needed:
            self._previous_users.add(renderer)
        else:
            self._previous_users.discard(renderer)

    # ---- from changes to the device -----------------------------------------------------------------

    def update(self, renderer: Any = None) -> None:
        """Apply all changes since the latest call. Raises SolariError for a scene that is too large, and for
        numbers of its assets' tensors that the device has refused.

        renderer: the one that is about to render a frame, if any. The previous positions of posed meshes are those of
        its latest frame. `previous_tlas` is from before the latest change until a renderer that has rendered the
        changed scene is about to do so again.
        """
        self.device.check_open()
        self.tensors.check()
        if self.tlas is not None:
            self.bindings_version += self.tlas.keep_previous(bool(self._previous_users))
        key = self if renderer is None else renderer
        if not self._is_current or any(records.changed for records in self._all_records):
            self._apply_changes(renderer)
        else:
            self.assets.set_previous_positions(renderer)
            if self.tlas is not None and key in self._up_to_date:
                self.tlas.rebuild()
        self._up_to_date.add(key)
        self.assets.geometry.moved_trees.improve()
        self.assets.geometry.posed.mark_seen(renderer, self.scene_revision)

    def _apply_changes(self, renderer: Any) -> None:
        self._is_current = False
        self._up_to_date = weakref.WeakSet()
        self.scene_revision += 1
        try:
            self._update_records(renderer)
            self._count_features()
            self._upload()
        except BaseException:
            self._try_again_later()
            raise
        for records in self._all_records:
            records.confirm()
        self._is_current = True

    def _update_records(self, renderer: Any) -> None:
        """Write the records of all that has changed."""
        assets = self.assets
        for records in self._all_records:
            records.apply_changes()
        # Materials name rows of textures, and instances those of meshes and materials, which must be up to date before.
        with_other_structures = assets.geometry.update(self.scene_revision)
        assets.geometry.posed.set_previous_positions(renderer)
        self.bindings_version += assets.textures.update()
        assets.materials.update()
        for records in self._all_records:
            records.write(with_other_structures)

    def _count_features(self) -> None:
        if self.features != self._counted_features:
            self._counted_features = self.features
            self.bindings_version += 1

    def _upload(self) -> None:
        """Copy the tables' changes and build the TLAS, before the next submission."""
        if self.tlas is not None:
            self.bindings_version += self.tlas.make_room()
        else:
            for records in self._all_records:
                records.write_for_worlds()
        # Poses read the uploaded tables, and the TLAS is built over the structures that poses refit.
        self.bindings_version += self.assets.upload(self._tables)
        self.assets.geometry.posed.submit()
        if self.tlas is not None:
            structures = self.assets.geometry.structures
            self.tlas.rebuild(structures.all_alive)
            structures.all_alive = True

    def _try_again_later(self) -> None:
        """After an error, have the next update apply the same changes and upload everything."""
        for records in self._all_records:
            records.retry()
        self.bindings_version += 1  # buffers may be other ones by now
        for table in self._tables:
            table.mark_all()
        if self.tlas is not None:
            self.tlas.mark_all()

    def destroy(self) -> None:
        """Stop watching the scenes and free everything."""
        for records in self._all_records:
            records.destroy()
        self.assets.destroy()
        if self.tlas is not None:
            self.tlas.destroy()


def _needs_light(scene: Scene) -> bool:
    """Whether what a scene shows needs light: unlit materials don't, and an empty scene is black on purpose."""
    shown = [instance.material for instance in scene if instance.visible]
    return bool(shown) and not any(material.unlit for material in shown)
