"""Keeps the resources of descriptor set 0 equal to a scene: uploads what changed, and rebuilds the TLAS.

The scene tells the binder which objects have changed. `update` turns changes into rows of tables, uploads and builds of
acceleration structures, which the device executes just before the next submission. Uploads and builds are proportional
to the change, not to the scene, but for lights: bound/lights/light_list.py says which changes concern all of them.
"""

from __future__ import annotations

import weakref
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.constants import NO_INDEX
from solari_vk.bound.features import Features
from solari_vk.bound.geometry import Geometry, Shape
from solari_vk.bound.lights.lamps import Lamps
from solari_vk.bound.lights.light_list import LightList
from solari_vk.bound.material_table import MaterialTable
from solari_vk.bound.table import Rows, Table, upload
from solari_vk.bound.texture_table import TextureTable
from solari_vk.bound.traced_instances import TracedInstances
from solari_vk.errors import SolariError
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.stopwatch import Stopwatch
from solari_vk.gpu.shaders import spirv
from solari_vk.gpu.shaders.compiler import compile_shader
from solari_vk.scene.model import Camera, Instance, Light, Material, Mesh, Scene, Texture, TextureImage
from solari_vk.scene.observed import Observable

MAX_INSTANCES = 1 << 24
# The fields that `_write_instance` sets, in order.
INSTANCE = ("world_from_object", "mesh", "ray_mesh", "material", "light_index", "id")


class SceneBinder:
    """A scene on a device, which several renderers may share. `resources` are those of descriptor set 0, by name.

    `version` increases when a resource was replaced or the scene got a new feature, `revision` with each change of the
    scene, `light_revision` with those that lists of lights may depend on, but for materials' emission.
    """

    def __init__(self, device: Device, scene: Scene) -> None:
        self.scene = scene
        self.version = self.revision = self.light_revision = self.blended_changes = 0
        self._device = device
        bindings = spirv.reflect(compile_shader("scene/layout.comp"), "scene/layout.comp").bindings
        layout: dict[str, Any] = {name: b.dtype if b.element is None else b.element for name, b in bindings.items()}
        self._features = Features()
        self._uses: dict[Instance, tuple[Shape, Shape, Material]] = {}
        with device.undone_on_error():
            self._geometry = Geometry(device, layout, self._features, self)
            self._textures = TextureTable(device, layout["textures"], self)
            self.lights = LightList(device, layout)  # as of the latest `update`
            self.lamps = Lamps(device, layout, self.lights, self._geometry, self._uses)
            self.materials = MaterialTable(device, layout["materials"], self._textures, self._features, self)
            self.instance_table = Table(device, "instances", layout["instances"], INSTANCE)
            self.instance_rows: Rows[Instance] = Rows()  # of instance_table
            self.traced = TracedInstances(device)  # as rays see them
        self._tables = (self._geometry.table, *self._geometry.posed.tables, self._textures.table,
                        self.materials.table, self.instance_table, *self.lights.tables, self.traced.table)  # fmt: skip
        self._unbound = (self.traced.table, *self._geometry.posed.tables)  # no frame's shader has them
        self._ids: dict[Instance, int] = {}
        self._last_id = 0
        self._previous_users: set[object] = set()
        self._up_to_date = weakref.WeakSet[Any]()  # who has used the scene since its latest change
        self._changed: dict[Observable, None] = dict.fromkeys((*scene.instances, *scene.lights, *scene.cameras))
        scene.watch(self)
        self._write_rows, self._first = dict[Instance, None](), True

    def note(self, changed: Observable) -> None:
        """Record that an object was added, removed or edited. The watched objects call this."""
        self._changed[changed] = None

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
    def instances(self) -> dict[int, Instance]:
        """The instances and bodies of lights by their rows, the shaders' indices, as of the latest `update`."""
        return {self.instance_rows[instance]: instance for instance in self._uses}

    @property
    def instance_capacity(self) -> int:
        """The number of rows in the shaders' `instances`."""
        return len(self.instance_table.records)

    @property
    def triangle_orders(self) -> dict[int, NDArray[np.int64]]:
        """For each row of `meshes` in use: the mesh's triangle of each uploaded triangle."""
        return {self._geometry.rows[mesh]: order for mesh, order in self._geometry.orders.items()}

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
        self.version += self.traced.keep_previous(bool(self._previous_users))
        posed = self._geometry.posed
        if not self._changed and not self._first:
            if posed.show(user):
                upload(self._device, [self._geometry.table])
            if (self if user is None else user) in self._up_to_date:
                self.traced.rebuild()
            self._note_use(user)
            return
        self._first = False
        self._up_to_date = weakref.WeakSet()
        self.revision += 1
        changed, self._changed = self._changed, {}
        features = self.features
        try:
            for item in changed:
                self._take_up(item)
            self._note_alpha()
            self._write_rows.update(dict.fromkeys(self._geometry.update(self.revision)))
            posed.show(user)
            self.version += self._textures.update()
            self.materials.update()
            self._update_instances()
            self.lights.update(self.traced.lit_area)
            self.version += self.features != features
            self._upload()
        except BaseException:
            self._changed = changed | self._changed  # the next update tries again, and uploads everything
            for table in self._tables:
                table.mark_all()
            self.traced.mark_all()
            raise
        self._note_use(user)

    def _note_use(self, user: Any) -> None:
        self._up_to_date.add(self if user is None else user)
        self._geometry.posed.note_seen(user, self.revision)

    # ---- from changed objects to rows ---------------------------------------------------------------

    def _take_up(self, item: Observable) -> None:
        self.light_revision += not isinstance(item, (Instance, Material, Camera))
        if isinstance(item, Instance):
            used = self._uses.get(item)
            self._take_up_instance(item)
            self.light_revision += self.lights.index(item) is not None or self._uses.get(item) != used
        elif isinstance(item, Light):
            present = item in self.scene.lights
            if present:
                self._features.note(item)
            (item.watch if present else item.unwatch)(self)
            if body := self.lights.set_light(item, present):
                self._take_up_instance(body)
                self._changed.pop(body, None)
        elif isinstance(item, Camera):
            self._features.note(item)
        elif isinstance(item, Material):
            # Worlds of a batch have materials for instances that may have left the scene, and lamps of their own.
            self._write_rows |= {user: None for user in self.materials.change(item) if user in self._uses}
        elif isinstance(item, Mesh):
            users = self._geometry.change(item)
            for instance in users:
                self._take_up_instance(instance)  # its pose may have no effect any more
            self.lamps.emissions.change(item)
            for instance in users:
                if self.lights.index(instance) is not None:
                    self.lights.renew(instance)
        elif isinstance(item, (Texture, TextureImage)):
            self._textures.change(item)
            users = [*self.lamps.emissions.change(item), *self.materials.users_of_image(item)]
            self._write_rows |= {user: None for user in users if user in self._uses}

    def _take_up_instance(self, instance: Instance) -> None:
        self.blended_changes += instance.alpha_mode == "blend"
        before = self._uses.get(instance)
        if instance in self.scene.instances or instance in self.lights.bodies:
            shape = self._geometry.shape(instance.mesh, instance)
            ray_shape = shape if instance.ray_mesh is None else self._geometry.shape(instance.ray_mesh, instance)
            after = shape, ray_shape, instance.material
            self._features.note(instance)
            if before is None and self.instance_rows.acquire(instance, None):
                instance.watch(self)
                self._last_id = self._ids[instance] = self._last_id + 1
                if self.instance_rows.limit > MAX_INSTANCES:
                    raise SolariError(f"{self.scene.describe()} has more than {MAX_INSTANCES} instances")
            self._write_rows[instance] = None
            if before != after:
                if before is not None and before[1] is not ray_shape and self.lights.index(instance) is not None:
                    self.lights.renew(instance)
                self._acquire(instance, *after)
                self._uses[instance] = after
        elif before is not None:
            instance.unwatch(self)
            row = self.instance_rows[instance]
            self.instance_table.reserve(row + 1)  # the update that added the instance may have failed before
            self._write_rows.pop(instance, None)
            self._set_lamp(instance, row, False)
            self.traced.remove(row)
            self.instance_table.records["mesh"][row] = self.instance_table.records["ray_mesh"][row] = NO_INDEX
            self.instance_table.mark([row])
            del self._uses[instance], self._ids[instance]
            self.instance_rows.release(instance, None)
        if before is not None and before != self._uses.get(instance):
            self._release(instance, *before)

    def _acquire(self, instance: Instance, mesh: Shape, ray_mesh: Shape, material: Material) -> None:
        self._geometry.acquire(mesh, instance, traced=False)
        self._geometry.acquire(ray_mesh, instance, traced=True)
        self.materials.acquire(material, instance)

    def _release(self, instance: Instance, mesh: Shape, ray_mesh: Shape, material: Material) -> None:
        self._geometry.release(mesh, instance, traced=False)
        self._geometry.release(ray_mesh, instance, traced=True)
        self.materials.release(material, instance)

    # ---- from rows to records -----------------------------------------------------------------------

    def _set_lamp(self, instance: Instance, row: int, emits: bool) -> None:
        self._write_rows |= dict.fromkeys(self.lamps.set(instance, row, emits))

    def note_feature(self, item: Observable) -> None:
        """Take note of what another world has in place of an object of the scene."""
        before = self.features
        self._features.note(item)
        self.version += self.features != before

    def meet_once(self, mesh: Mesh) -> bool:
        """As `Geometry.meet_once`; another `update` is needed if it returns True."""
        if new := self._geometry.meet_once(mesh):
            self.note(mesh)
        return new

    def _note_alpha(self) -> None:
        for instance in self._write_rows:
            if instance.alpha_mode != "opaque":
                self._features.note(instance)
                if instance.alpha_mode == "blend":
                    self._geometry.meet_once(instance.ray_mesh or instance.mesh)

    def _update_instances(self) -> None:
        self.instance_table.reserve(self.instance_rows.limit)
        for instance in list(self._write_rows):
            emits = instance.visible and instance.material in self.materials.emitting
            if emits or self.lights.index(instance) is not None:
                self._set_lamp(instance, self.instance_rows[instance], emits)
        self.lamps.emissions.end_update()
        for instance in self._write_rows:
            self._write_instance(instance)
        self._write_rows.clear()

    def _write_instance(self, instance: Instance) -> None:
        """Write an instance's records as plain numbers, which is fastest for the few that move in most frames."""
        row, visible, material = self.instance_rows[instance], instance.visible, instance.material
        mesh, ray_mesh, _ = self._uses[instance]
        rows, light = self._geometry.rows, self.lights.index(instance)
        (a, b, c, x), (d, e, f, y), (g, h, i, z), _ = instance.transform.tolist()
        self.instance_table.set(
            row, a, d, g, b, e, h, c, f, i, x, y, z, rows[mesh] if visible else NO_INDEX, rows[ray_mesh],
            self.materials.rows[material], NO_INDEX if light is None else light, self._ids[instance],
        )  # fmt: skip
        box = self._geometry.centers[ray_mesh], self._geometry.half_sizes[ray_mesh]
        self.traced.write(
            row, (a, b, c, x, d, e, f, y, g, h, i, z), box, visible, material.double_sided, instance.alpha_mode,
            self._geometry.blases[ray_mesh].address,
        )  # fmt: skip

    # ---- from records to the device -----------------------------------------------------------------

    def _upload(self) -> None:
        """Copy the tables' changes and build the TLAS, before the next submission."""
        if self.traced.update():
            self.version += 1
        changed = [table for table in self._tables if table.marked]
        for table in changed:
            if table.replace():
                self.version += 1
        upload(self._device, changed)
        self._geometry.posed.submit()
        self.traced.rebuild(self._geometry.kept)
        self._geometry.kept = True

    def destroy(self) -> None:
        """Stop watching the scene and free everything."""
        self.scene.unwatch(self)
        for item in (*self._uses, *self.scene.lights):
            item.unwatch(self)
        for owner in (self._geometry, self.materials, self._textures, self.lamps.emissions, self.lights,
                      self.instance_table, self.traced):  # fmt: skip
            owner.destroy()
