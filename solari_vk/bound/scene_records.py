"""The instances and lights of one scene as records, in tables on the device or on the host, which follow its edits.

The scene tells its records which objects have changed. `apply_changes` gives new and edited meshes, textures and
materials to the assets; when these are up to date, `write` writes the records.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.bound.assets import Assets
from solari_vk.bound.constants import NO_INDEX, WITHOUT_BLEND, WITHOUT_DISPERSION
from solari_vk.bound.features import LARGE, LARGE_SIZE, VAST, VAST_SIZE
from solari_vk.bound.geometry import DeviceMesh
from solari_vk.bound.lights.emissive_meshes import Emission, Emissions
from solari_vk.bound.lights.light_list import LightList, Position
from solari_vk.bound.table import MakeTable, RowAllocator
from solari_vk.bound.traced_instances import TracedRecords
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.tensors.imports import DeviceTensor
from solari_vk.scene.matrices import placed_box
from solari_vk.scene.model import Camera, Instance, Light, Material, Mesh, Scene, Texture, TextureImage
from solari_vk.scene.observable import Observable
from solari_vk.scene.tensor_fields import TensorFields

MAX_INSTANCES = 1 << 24  # a custom index of an acceleration structure has 24 bits
# The fields that `_write_instance` sets, in order.
INSTANCE = ("world_from_object", "mesh", "ray_mesh", "material", "light_index", "id")


class SceneRecords:
    """The instances and lights of a scene as records. assets: what it may share with other scenes. table: makes the
    tables of the records. lights: the scene's list of lights. origin: the scene's, from which all coordinates in
    the records count, (3,).
    """

    def __init__(
        self,
        device: Device,
        scene: Scene,
        assets: Assets,
        table: MakeTable,
        lights: LightList,
        origin: NDArray[np.float64],
    ) -> None:
        self.scene = scene
        self.origin = origin
        self._origin: list[float] = origin.tolist()
        self.lights = lights  # as of the latest `write`
        self.traced = TracedRecords(table, device.properties.kind)
        self.instance_table = table("instances", assets.block_dtypes["instances"], INSTANCE)
        self.instance_rows: RowAllocator[Instance] = RowAllocator()  # of instance_table
        self.emissions = Emissions(device, assets.block_dtypes["light_leaves"]["by_power"])
        self.absent_features = WITHOUT_BLEND | WITHOUT_DISPERSION
        """Flags of the features that no instance of the scene has had so far, such as WITHOUT_BLEND."""
        self._was_written = False
        """Counts the updates that changed something in the scene."""
        self.record_revision = 0
        """Counts those that may have changed records of instances or lights. A texture's count if it has alpha or
        emits."""
        self.light_revision = 0
        """Counts the changes that may concern the list of lights. What a material emits isn't among them."""
        self.blended_changes = 0
        """Counts the changes of blended instances."""
        self.look_changes = 0
        """Counts the edits of lights, materials and textures, and of which instances there are: they may change what
        still surfaces look like."""
        self.moves = 0
        """Counts the other edits of instances and meshes, which move shadows."""
        self._assets = assets
        self._geometry = assets.geometry
        # The meshes that raster and rays see of each instance, and its material.
        self._uses: dict[Instance, tuple[DeviceMesh, DeviceMesh, Material]] = {}
        self._ids: dict[Instance, int] = {}
        self._written_as: dict[Instance, tuple[Any, ...]] = {}
        self._last_id = 0
        self._changed: dict[Observable, None] = dict.fromkeys((*scene.instances, *scene.lights, *scene.cameras))
        self._applied: dict[Observable, None] = {}  # changes that may not be on the device yet
        self._to_write = dict[Instance, None]()
        self._records_change = False  # but for those in _to_write
        scene.watch(self)

    def mark_changed(self, changed: Observable) -> None:
        """Record that an object was added, removed or edited. The watched objects call this."""
        self._changed[changed] = None

    @property
    def instances(self) -> dict[int, Instance]:
        """The instances and blockers of lights by their rows, the shaders' indices, as of the latest `write`."""
        return {self.instance_rows[instance]: instance for instance in self._uses}

    @property
    def instance_capacity(self) -> int:
        """The number of rows in the shaders' `instances`."""
        return len(self.instance_table.records)

    @property
    def changed(self) -> bool:
        """Whether the scene was edited since the latest `apply_changes`."""
        return bool(self._changed)

    def has_any(self, instances: Iterable[Instance]) -> bool:
        """Whether one of these is in the scene."""
        return any(instance in self._uses for instance in instances)

    @property
    def edit_counts(self) -> tuple[int, int, int]:
        """`look_changes`, `moves` and `blended_changes`, for `RecentEdits`."""
        return self.look_changes, self.moves, self.blended_changes

    # ---- an update, step by step ---------------------------------------------------------------------

    def apply_changes(self) -> None:
        """Apply all changes since the last time. Raises SolariError for a scene that is too large."""
        self._applied = self._changed
        self._changed = {}
        for item in self._applied:
            self._apply_change(item)
        # Alpha depends on textures and meshes too, so that all of them must be applied before.
        self._add_alpha_features()

    def write(self, users: Iterable[Instance]) -> None:
        """Write the records of what has changed, and of instances, some of the scene, that have other acceleration
        structures now."""
        self._write_later(users)
        if self._was_written and not (self._applied or self._to_write):
            return
        self._was_written = True
        # Texels, and numbers of materials in tensors, stand in no record of an instance: worlds need no new copies
        # then.
        if self._records_change or self._to_write:
            self.record_revision += 1
        self._records_change = False
        self._update_instances()
        self.lights.update(self.traced.lit_area)
        self._assets.features.add_of(self.lights.leaves.choice)

    def write_for_worlds(self) -> None:
        """Bring the records into the form that worlds of several scenes copy: in spatial order, and with the features
        of the other scenes' shaders that this scene must not use."""
        self.traced.sort()
        info = self.lights.info
        if info.records["absent_features"][0] != self.absent_features:
            info.records["absent_features"][0] = self.absent_features
            info.mark([0])

    def confirm(self) -> None:
        """Forget the changes that were applied: all of them are on the device."""
        self._applied = {}

    def retry(self) -> None:
        """Have the next `apply_changes` apply them again, after an error."""
        self._changed = self._applied | self._changed

    # ---- from changed objects to rows ---------------------------------------------------------------

    def _apply_change(self, item: Observable) -> None:
        for kind, apply in self._HANDLERS:
            if isinstance(item, kind):
                apply(self, item)
                return

    def _apply_instance(self, instance: Instance) -> None:
        before = self._uses.get(instance)
        self._records_change = True
        self._follow_instance(instance)
        if self._written_as.get(instance) == _record_key(instance):
            self.moves += 1
        else:
            self.look_changes += 1
        if self.lights.index(instance) is not None or self._uses.get(instance) != before:
            self.light_revision += 1

    def _apply_light(self, light: Light) -> None:
        self.light_revision += 1
        self.look_changes += 1
        self._records_change = True
        present = light in self.scene.lights
        if present:
            self._assets.features.add_of(light)
            light.watch(self)
        else:
            light.unwatch(self)
        blocker = self.lights.set_light(light, present)
        if blocker is not None:
            self._follow_instance(blocker)
            # The list of lights has moved the blocker, which notified these records: that is applied already.
            self._changed.pop(blocker, None)

    def _apply_camera(self, camera: Camera) -> None:
        self._records_change = True
        self._assets.features.add_of(camera)

    def _apply_material(self, material: Material) -> None:
        self.look_changes += 1
        was_blended = self._assets.materials.was_blended(material)
        users = self._assets.materials.mark_changed(material)
        if was_blended or any(instance.alpha_mode == "blend" for instance in users):
            self.blended_changes += 1
        # A light's record depends on what an emitter emits, and worlds of a batch have this material for instances that
        # have another one in the scene. Else records say how rays meet an instance, which most edits leave as it is:
        # no structure is built then.
        emits = material.emits or material in self._assets.materials.emitting
        self._write_later(
            user
            for user in users
            if emits or user.material is not material or self._written_as.get(user) != _record_key(user)
        )

    def _apply_mesh(self, mesh: Mesh) -> None:
        if self._may_change_lights(mesh, "positions"):
            self.light_revision += 1
        self._records_change = True
        self.moves += 1
        # The mesh may have users in other scenes too.
        users = [user for user in self._geometry.mark_changed(mesh) if user in self._uses]
        for instance in users:
            self._follow_instance(instance)  # its pose may have no effect any more
        self.emissions.drop_edited(mesh)
        for instance in users:
            if self.lights.index(instance) is not None:
                self.lights.renew_id(instance)

    def _apply_texture(self, texture: Texture) -> None:
        self.light_revision += 1
        self._apply_texels(texture)

    def _apply_image(self, image: TextureImage) -> None:
        if self._may_change_lights(image, "pixels"):
            self.light_revision += 1
        self._apply_texels(image)

    def _apply_texels(self, item: Texture | TextureImage) -> None:
        self.look_changes += 1
        self._assets.textures.mark_changed(item)
        emitters = self.emissions.drop_edited(item)
        self._records_change |= len(emitters) > 0  # worlds of a batch have emitters of their own
        self._write_later([*emitters, *self._assets.materials.alpha_users_of(item)])

    _HANDLERS: tuple[tuple[type[Observable], Callable[[SceneRecords, Any], None]], ...] = (
        (Instance, _apply_instance),
        (Light, _apply_light),
        (Camera, _apply_camera),
        (Material, _apply_material),
        (Mesh, _apply_mesh),
        (Texture, _apply_texture),
        (TextureImage, _apply_image),
    )

    def _may_change_lights(self, item: TensorFields, field: str) -> bool:
        """Whether an edit of a mesh or an image may change the lights: a tensor on the device changes nothing of what
        the host knows, but for objects that emit."""
        return not isinstance(item._stored(field), DeviceTensor) or self.emissions.depend_on(item)

    def _write_later(self, instances: Iterable[Instance]) -> None:
        """Have `write` write the records of these, if they are in the scene."""
        self._to_write |= {instance: None for instance in instances if instance in self._uses}

    def _follow_instance(self, instance: Instance) -> None:
        """Add, update or remove the rows of an instance, and what it uses of the assets."""
        if instance.alpha_mode == "blend":
            self.blended_changes += 1
        before = self._uses.get(instance)
        if instance in self.scene.instances or instance in self.lights.blockers:
            self._add_or_update(instance, before)
        elif before is not None:
            self._remove(instance)
        # What was used before is released last, so that an asset which is still used stays on the device.
        if before is not None and before != self._uses.get(instance):
            self._release(instance, *before)

    def _add_or_update(self, instance: Instance, before: tuple[DeviceMesh, DeviceMesh, Material] | None) -> None:
        # Before anything is acquired, or an instance that is refused would keep it.
        if instance not in self.instance_rows and len(self.instance_rows) >= MAX_INSTANCES:
            raise SolariError(f"{self.scene.describe()} has more than {MAX_INSTANCES} instances")
        device_mesh = self._geometry.device_mesh(instance.mesh, instance)
        device_ray_mesh = (
            device_mesh if instance.ray_mesh is None else self._geometry.device_mesh(instance.ray_mesh, instance)
        )
        after = device_mesh, device_ray_mesh, instance.material
        self._assets.features.add_of(instance)
        if before is None and self.instance_rows.acquire(instance, None):
            instance.watch(self)
            self._last_id += 1
            self._ids[instance] = self._last_id
        self._to_write[instance] = None
        if before != after:
            if before is not None and before[1] is not device_ray_mesh and self.lights.index(instance) is not None:
                self.lights.renew_id(instance)
            self._acquire(instance, *after)
            self._uses[instance] = after

    def _remove(self, instance: Instance) -> None:
        instance.unwatch(self)
        row = self.instance_rows[instance]
        self.instance_table.reserve(row + 1)  # the update that added the instance may have failed before
        self._to_write.pop(instance, None)
        self._set_emitter(instance, row, False)
        self.traced.remove(row)
        self.instance_table.records["mesh"][row] = NO_INDEX
        self.instance_table.records["ray_mesh"][row] = NO_INDEX
        self.instance_table.mark([row])
        del self._uses[instance], self._ids[instance]
        self._written_as.pop(instance, None)
        self.instance_rows.release(instance, None)

    def _acquire(self, instance: Instance, mesh: DeviceMesh, ray_mesh: DeviceMesh, material: Material) -> None:
        self._geometry.acquire(mesh, instance, traced=False)
        self._geometry.acquire(ray_mesh, instance, traced=True)
        self._assets.materials.acquire(material, instance)

    def _release(self, instance: Instance, mesh: DeviceMesh, ray_mesh: DeviceMesh, material: Material) -> None:
        self._geometry.release(mesh, instance, traced=False)
        self._geometry.release(ray_mesh, instance, traced=True)
        self._assets.materials.release(material, instance)

    def _add_alpha_features(self) -> None:
        for instance in self._to_write:
            if instance.alpha_mode != "opaque":
                self._assets.features.add_of(instance)
            if instance.alpha_mode == "blend":
                self._geometry.use_no_duplicate_any_hit(instance.ray_mesh or instance.mesh)

    # ---- emitters -----------------------------------------------------------------------------------

    def emission_of(self, instance: Instance, original: Instance) -> tuple[Emission, float, Position, Position]:
        """What `LightList.set_emissive` is told of an instance that emits light: its emission, which lasts until
        `emissions` releases it, its area, position and half size. original: the scene's instance with its meshes."""
        _, device_mesh, _ = self._uses[original]
        center, half_size, volume = placed_box(instance.transform, *self._geometry.box(device_mesh))
        position = center[0] - self._origin[0], center[1] - self._origin[1], center[2] - self._origin[2]
        emission = self.emissions.acquire(instance, self._geometry.orders[device_mesh])
        # An instance that is scaled by s has s^2 times the area, and s^3 times the volume.
        return emission, volume ** (2 / 3) * emission.area_in(instance.joint_matrices), position, half_size

    def _set_emitter(self, instance: Instance, row: int, emits: bool) -> None:
        """Add, update or remove the light of the instance of a row."""
        if emits:
            moved = self.lights.set_emissive(instance, row, *self.emission_of(instance, instance))
        else:
            self.emissions.release(instance)
            moved = self.lights.set_emissive(instance, row, None)
        if moved is not None:
            # The last light took the index of a removed one, which the record of its instance has to say.
            self._to_write[moved] = None

    # ---- from rows to records -----------------------------------------------------------------------

    def _update_instances(self) -> None:
        self.instance_table.reserve(self.instance_rows.high_water_mark)
        # Emitters first, since an instance's record has its index among the lights, and removing one moves another.
        for instance in list(self._to_write):
            emits = instance.visible and instance.material in self._assets.materials.emitting
            if emits or self.lights.index(instance) is not None:
                self._set_emitter(instance, self.instance_rows[instance], emits)
        self.emissions.end_update()
        for instance in self._to_write:
            self._write_instance(instance)
        self._to_write.clear()

    def _write_instance(self, instance: Instance) -> None:
        """Write an instance's records as plain numbers, which is fastest for the few that move in most frames."""
        row = self.instance_rows[instance]
        self._written_as[instance] = _record_key(instance)
        visible = instance.visible
        material = instance.material
        alpha_mode = instance.alpha_mode
        mesh, ray_mesh, _ = self._uses[instance]
        mesh_rows = self._geometry.rows
        light = self.lights.index(instance)
        if alpha_mode == "blend":
            self.absent_features &= ~WITHOUT_BLEND
        if material.disperses:
            self.absent_features &= ~WITHOUT_DISPERSION
        (a, b, c, x), (d, e, f, y), (g, h, i, z), _ = instance.transform.tolist()
        x -= self._origin[0]
        y -= self._origin[1]
        z -= self._origin[2]
        scale = math.sqrt(max(a * a + d * d + g * g, b * b + e * e + h * h, c * c + f * f + i * i))
        self.use_scale(instance, scale)
        columns = (a, d, g, b, e, h, c, f, i, x, y, z)  # matrices of GLSL lie in memory column by column
        self.instance_table.set(
            row,
            *columns,
            mesh_rows[mesh] if visible else NO_INDEX,
            mesh_rows[ray_mesh],
            self._assets.materials.rows[material],
            NO_INDEX if light is None else light,
            self._ids[instance],
        )
        self.traced.write(
            row,
            (a, b, c, x, d, e, f, y, g, h, i, z),
            (self._geometry.centers[ray_mesh], self._geometry.half_sizes[ray_mesh]),
            visible,
            material.hides_back,
            alpha_mode,
            ray_mesh,
            self._geometry.blases[ray_mesh],
        )

    def use_scale(self, instance: Instance, scale: float) -> None:
        """Add the features of large instances that an instance has at a scale."""
        _, ray_mesh, _ = self._uses[instance]
        size = 2 * scale * float(self._geometry.half_sizes[ray_mesh].max())
        if size >= LARGE_SIZE:
            self._assets.features.add(LARGE)
        if size >= VAST_SIZE:
            self._assets.features.add(VAST)

    def destroy(self) -> None:
        """Stop watching the scene, and free what is on the device but the assets."""
        self.scene.unwatch(self)
        for item in (*self._uses, *self.scene.lights):
            item.unwatch(self)
        for owner in (self.emissions, self.lights, self.instance_table, self.traced.table):
            owner.destroy()


def _record_key(instance: Instance) -> tuple[Any, ...]:
    """What the records of an instance hold beside its place and its light."""
    material = instance.material
    return instance.visible, material, instance.alpha_mode, material.hides_back, material.disperses
