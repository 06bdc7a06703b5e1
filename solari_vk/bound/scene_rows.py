"""The rows of a scene's instances and lights, in tables on the device or on the host, which follow the scene's edits.

The scene tells its rows which objects have changed. `take_up` gives new and changed meshes, textures and materials to
the assets; when these are up to date, `write` writes the records.
"""

from __future__ import annotations

from collections.abc import Iterable

from solari_vk.base.errors import SolariError
from solari_vk.bound.assets import Assets
from solari_vk.bound.constants import NO_INDEX, WITHOUT_BLEND, WITHOUT_DISPERSION
from solari_vk.bound.geometry import Shape
from solari_vk.bound.lights.lamps import Lamps
from solari_vk.bound.lights.light_list import LightList
from solari_vk.bound.table import MakeTable, Rows
from solari_vk.bound.traced_instances import TracedRecords
from solari_vk.gpu.device.cuda_input import Taken
from solari_vk.gpu.device.device import Device
from solari_vk.scene.model import Camera, Instance, Light, Material, Mesh, Scene, Texture, TextureImage
from solari_vk.scene.observed import Observable

MAX_INSTANCES = 1 << 24
# The fields that `_write_instance` sets, in order.
INSTANCE = ("world_from_object", "mesh", "ray_mesh", "material", "light_index", "id")


class SceneRows:
    """The instances and lights of a scene as records. assets: what it may share with other scenes. table: where the
    records are. traced, lights: these as rays and light samples find them.

    `revision` increases with each change of the scene; `record_revision` with those on which records of instances or
    lights may depend: of textures those of alpha and emission alone; `light_revision` with those on which lists of
    lights may depend, but for materials' emission; `blended_changes` with those of blended instances.
    """

    def __init__(
        self, device: Device, scene: Scene, assets: Assets, table: MakeTable, traced: TracedRecords, lights: LightList
    ) -> None:
        self.scene = scene
        self.revision = self.record_revision = self.light_revision = self.blended_changes = 0
        self._uses: dict[Instance, tuple[Shape, Shape, Material]] = {}
        self.assets, self.traced, self.lights = assets, traced, lights  # as of the latest `write`
        self.materials, self._geometry = assets.materials, assets.geometry
        self._features, self._textures = assets.features, assets.textures
        self.lamps = Lamps(device, assets.layout, lights, self._geometry, self._uses)
        self.instance_table = table("instances", assets.layout["instances"], INSTANCE)
        self.instance_rows: Rows[Instance] = Rows()  # of instance_table
        self.without = WITHOUT_BLEND | WITHOUT_DISPERSION
        """The features that no instance of the scene has had so far."""
        self._ids: dict[Instance, int] = {}
        self._last_id = 0
        self._changed: dict[Observable, None] = dict.fromkeys((*scene.instances, *scene.lights, *scene.cameras))
        self._taken: dict[Observable, None] = {}
        scene.watch(self)
        self._write_rows = dict[Instance, None]()
        self._records_change = False  # but for those in _write_rows

    def note(self, changed: Observable) -> None:
        """Record that an object was added, removed or edited. The watched objects call this."""
        self._changed[changed] = None

    @property
    def instances(self) -> dict[int, Instance]:
        """The instances and bodies of lights by their rows, the shaders' indices, as of the latest `write`."""
        return {self.instance_rows[instance]: instance for instance in self._uses}

    @property
    def instance_capacity(self) -> int:
        """The number of rows in the shaders' `instances`."""
        return len(self.instance_table.records)

    @property
    def changed(self) -> bool:
        """Whether the scene was edited since the latest `take_up`."""
        return bool(self._changed)

    def uses(self, instances: Iterable[Instance]) -> bool:
        """Whether one of these is in the scene."""
        return any(instance in self._uses for instance in instances)

    def take_up(self) -> None:
        """Take up all changes since the last time. Raises SolariError for a scene that is too large."""
        self._taken, self._changed = self._changed, {}
        for item in self._taken:
            self._take_up(item)
        self._note_alpha()

    def write(self, users: Iterable[Instance]) -> None:
        """Write the records of what has changed, and of instances, some of the scene, that have other acceleration
        structures now."""
        self._write_rows |= {user: None for user in users if user in self._uses}
        if self.revision and not (self._taken or self._write_rows):
            return
        self.revision += 1
        self.record_revision += self._records_change or bool(self._write_rows)
        self._records_change = False
        self._update_instances()
        self.lights.update(self.traced.lit_area)
        self._features.note(self.lights.leaves.light_tree)

    def settle(self) -> None:
        """Forget what was taken up, when all of it is on the device."""
        self._taken = {}

    def undo(self) -> None:
        """Have the next `take_up` try again, after an error."""
        self._changed = self._taken | self._changed

    # ---- from changed objects to rows ---------------------------------------------------------------

    def _take_up(self, item: Observable) -> None:
        self.light_revision += self._may_change_lights(item)
        self._records_change |= not isinstance(item, (Material, Texture, TextureImage))
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
            users = [instance for instance in users if instance in self._uses]  # the others are in other scenes
            for instance in users:
                self._take_up_instance(instance)  # its pose may have no effect any more
            self.lamps.emissions.change(item)
            for instance in users:
                if self.lights.index(instance) is not None:
                    self.lights.renew(instance)
        elif isinstance(item, (Texture, TextureImage)):
            self._textures.change(item)
            lamps = self.lamps.emissions.change(item)
            self._records_change |= len(lamps) > 0  # worlds have lamps of their own
            users = [*lamps, *self.materials.users_of_image(item)]
            self._write_rows |= {user: None for user in users if user in self._uses}

    def _may_change_lights(self, item: Observable) -> bool:
        if isinstance(item, (Mesh, TextureImage)) and isinstance(item._held(item._on_device[0]), Taken):
            return self.lamps.emissions.use(item)  # the host knows nothing new of others
        return not isinstance(item, (Instance, Material, Camera))

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
        rows, light, alpha_mode = self._geometry.rows, self.lights.index(instance), instance.alpha_mode
        if alpha_mode == "blend":
            self.without &= ~WITHOUT_BLEND
        if material.disperses:
            self.without &= ~WITHOUT_DISPERSION
        (a, b, c, x), (d, e, f, y), (g, h, i, z), _ = instance.transform.tolist()
        self.instance_table.set(
            row,
            a,
            d,
            g,
            b,
            e,
            h,
            c,
            f,
            i,
            x,
            y,
            z,
            rows[mesh] if visible else NO_INDEX,
            rows[ray_mesh],
            self.materials.rows[material],
            NO_INDEX if light is None else light,
            self._ids[instance],
        )
        box = self._geometry.centers[ray_mesh], self._geometry.half_sizes[ray_mesh]
        self.traced.write(
            row,
            (a, b, c, x, d, e, f, y, g, h, i, z),
            box,
            visible,
            material.double_sided,
            alpha_mode,
            self._geometry.blases[ray_mesh].address,
        )

    def unwatch(self) -> None:
        """Stop watching the scene."""
        self.scene.unwatch(self)
        for item in (*self._uses, *self.scene.lights):
            item.unwatch(self)

    def destroy(self) -> None:
        """Stop watching the scene, and free what is on the device but the assets."""
        self.unwatch()
        for owner in (self.lamps.emissions, self.lights, self.instance_table):
            owner.destroy()
