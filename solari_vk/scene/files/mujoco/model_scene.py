"""`ModelScene`: a MuJoCo model in a state as a scene, which later states move.

MuJoCo itself says what is shown: `mjv_updateScene` fills a list of geoms, lights and cameras as for its own pictures,
for which it needs no window. So groups, options, colors and decorations are those of its viewers.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, warn
from solari_vk.scene.camera import Camera
from solari_vk.scene.files.hierarchy import MOST_LEVELS
from solari_vk.scene.files.libraries import library
from solari_vk.scene.files.mujoco import geoms
from solari_vk.scene.files.mujoco.lights import AMBIENT, environment_of, light_fields, light_numbers
from solari_vk.scene.files.mujoco.surfaces import Surfaces, is_endless, is_uniform, look_of, upward
from solari_vk.scene.group import Group, distinct
from solari_vk.scene.lights.environment import Environment, EnvironmentLight
from solari_vk.scene.lights.light import Light
from solari_vk.scene.model import Instance, Mesh, Scene

MOST_GEOMS = 2000  # more than the model has, for decorations
HEADLIGHT = "headlight"
_SOFT = ("FLEX", "SKIN")
_UNDRAWN = {"LABEL", "LINEBOX", "TRIANGLE", "NONE"}
INSTALL = "pip install 'solari-vk[robots]'"

Key = tuple[int, int, int]
"""Of an mjvGeom: the type and the number of its object, and which of the object's geoms it is."""


def import_mujoco(who: str) -> Any:
    """The module mujoco. Raises SolariError if it isn't installed."""
    return library("mujoco", who, INSTALL)


def pose(position: Any, axes: Any) -> NDArray[np.float64]:
    """A matrix (4, 4) from a frame of MuJoCo to the scene: its axes are columns (3, 3) or (9,) by rows."""
    matrix = np.eye(4)
    matrix[:3, :3] = geoms.UP @ np.asarray(axes, np.float64).reshape(3, 3)
    matrix[:3, 3] = geoms.UP @ np.asarray(position, np.float64)
    return matrix


def check_data(mujoco: Any, model: Any, data: Any) -> None:
    """Raise SolariError unless data is an MjData of a model, with poses."""
    if not isinstance(data, mujoco.MjData):
        raise SolariError(
            f"mujoco: a state is an MjData, not {type(data).__name__}: give MjData(model) after mj_forward"
        )
    if (data.qpos.shape[0], data.geom_xpos.shape[0]) != (model.nq, model.ngeom):
        raise SolariError("mujoco: the MjData is that of another model: make it by MjData(model)")
    if not data.xmat[0].any():
        raise SolariError("mujoco: the MjData has no poses yet: call mujoco.mj_forward(model, data) before")


class ModelScene:
    """The scene of a model. `scene` has an instance for each geom that MuJoCo shows; `update` moves it."""

    def __init__(self, model: Any, name: str = "", *, most_geoms: int | None = None) -> None:
        self.mujoco = mujoco = import_mujoco("a model of MuJoCo")
        if not isinstance(model, mujoco.MjModel):
            raise SolariError(
                f"mujoco: the model is an MjModel, not {type(model).__name__}: make it by MjModel.from_xml_path, or by "
                "the compile of an MjSpec"
            )
        self.model = model
        self.scene = Scene(name=name)
        self.instances: dict[Key, Instance] = {}
        """All that was shown so far, by the objects of the model."""
        self.visual = mujoco.MjvScene(model, most_geoms or model.ngeom + model.nsite + MOST_GEOMS)
        self._cubes = model.tex_type == mujoco.mjtTexture.mjTEXTURE_CUBE if model.ntex else np.zeros(0, bool)
        self._surfaces = Surfaces(model, self._cubes)
        self._meshes: dict[Any, Mesh] = {}
        self._lights: dict[str, Light] = {}
        self._light_fields: dict[str, tuple[tuple[float, ...], dict[str, Any]]] = {}  # as the model last had them
        self._sky: Environment | None = None  # that was last made of the model
        self._ambient: tuple[float, ...] | None = None
        self._far = float(model.vis.map.zfar * model.stat.extent)
        self._undrawn: set[str] = set()
        self._names: dict[str, int] = {}
        given = [model.body(body).name for body in range(model.nbody)]
        used = dict.fromkeys(filter(None, given), 1)
        self._body_names = [name or distinct(f"body {body}", used) for body, name in enumerate(given)]

    # ---- states -------------------------------------------------------------------------------------

    def update(self, data: Any, camera: Any = None, option: Any = None) -> None:
        """Show a state: `fill` and `show`."""
        self.fill(data, camera, option)
        self.show()

    def fill(self, data: Any, camera: Any = None, option: Any = None) -> None:
        """Have MuJoCo list what is shown in `visual`: of a state, MjData, seen by an MjvCamera, with an MjvOption; by
        default the free camera and MuJoCo's own options."""
        mujoco = self.mujoco
        check_data(mujoco, self.model, data)
        if camera is None:
            camera = mujoco.MjvCamera()
            mujoco.mjv_defaultFreeCamera(self.model, camera)
        option = option or mujoco.MjvOption()
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(self.model, data, option, None, camera, everything, self.visual)
        remark = f"mujoco: only {self.visual.maxgeom} geoms are shown: give a larger max_geom"
        if self.visual.status and remark not in self.scene.warnings:
            self.scene.warnings.append(remark)
            warn(remark)

    def show(self) -> None:
        """Have the scene show what `visual` lists."""
        self._update_geoms()
        self._update_lights()

    def _update_geoms(self) -> None:
        counts: Counter[tuple[int, int]] = Counter()
        seen = set()
        for index in range(self.visual.ngeom):
            geom = self.visual.geoms[index]
            owner = int(geom.objtype), int(geom.objid)
            key = *owner, counts[owner]
            counts[owner] += 1
            kind = self.mujoco.mjtGeom(int(geom.type)).name[7:]
            if kind in _UNDRAWN:
                self._undrawn.add(kind.lower())
                continue
            seen.add(key)
            self._show(key, geom, kind)
        for key in self.instances.keys() - seen:
            if self.instances[key].visible:
                self.instances[key].visible = False
        if self._undrawn:
            remark = f"not drawn: {', '.join(sorted(self._undrawn))}"
            if remark not in self.scene.warnings:
                self.scene.warnings.append(remark)

    def _show(self, key: Key, geom: Any, kind: str) -> None:
        look = look_of(self.mujoco, self.model, geom)
        material = self._surfaces.material(look)
        instance = self.instances.get(key)
        if kind in _SOFT:
            mesh = geoms.soft_mesh(self.model, self.visual, kind, key[1])
            transform = pose(np.zeros(3), np.eye(3))
            if mesh is None:
                self._undrawn.add("flex without faces")
                return
        else:
            mesh = self._mesh(kind, geom, self._surfaces.uses_cube(look))
            transform = pose(geom.pos, geom.mat)
        if instance is None:
            instance = self._new_instance(key, kind, mesh, transform)
            if is_endless(self.mujoco, geom) and self.scene.backdrop is None:
                self.scene.backdrop = instance
        fields: dict[str, Any] = {"mesh": mesh, "material": material, "visible": True}
        changed = {name: value for name, value in fields.items() if getattr(instance, name) is not value}
        if not np.array_equal(instance.transform, transform):
            changed["transform"] = transform
        if changed:
            instance.update(**changed)

    def _mesh(self, kind: str, geom: Any, is_cube: bool) -> Mesh:
        size = np.array(geom.size, np.float64).round(9)
        of_model = kind in ("MESH", "SDF", "HFIELD")
        key = (kind, int(geom.dataid)) if of_model else (kind, *size.tolist())
        if is_cube:
            key = (*key, "cube", is_uniform(self.model, geom))
        if key not in self._meshes:
            self._meshes[key] = self._made(kind, int(geom.dataid), size)
            if is_cube:
                scale = np.ones(3) if of_model or key[-1] else np.where(size > 0, size, 1)
                self._meshes[key] = geoms.with_cube_uvs(self._meshes[key], scale)
        return self._meshes[key]

    def _made(self, kind: str, number: int, size: Any) -> Mesh:
        if kind == "HFIELD":
            return geoms.height_field(self.model, number)
        if kind in ("MESH", "SDF"):
            # Even numbers are meshes, odd ones their convex hulls, which MuJoCo shows on demand.
            return geoms.model_mesh(self.model, number // 2)
        return geoms.primitive(kind, size, self._far)

    def _new_instance(self, key: Key, kind: str, mesh: Mesh, transform: Any) -> Instance:
        """An instance with the names that labels of pictures are made of: the class is that of the body's tree, and
        the geoms of a body are parts of one object."""
        mujoco, model = self.mujoco, self.model
        owner, number, _ = key
        objects = mujoco.mjtObj
        fields: dict[str, Any] = {}
        name = mujoco.mj_id2name(model, owner, number) if number >= 0 else None
        if owner in (objects.mjOBJ_GEOM, objects.mjOBJ_SITE):
            body = int((model.geom_bodyid if owner == objects.mjOBJ_GEOM else model.site_bodyid)[number])
            if body:
                fields = {"label": self.body_name(int(model.body_rootid[body])), "part_of": self.body_name(body)}
            else:
                fields = {"label": name or kind.lower()}
            name = name or f"{self.body_name(body)}/{kind.lower()}"
        name = distinct(name or kind.lower(), self._names)
        self.instances[key] = self.scene.add(Instance(mesh, transform=transform, name=name, **fields))
        return self.instances[key]

    def body_name(self, body: int) -> str:
        """The name of a body, or one made of its number."""
        return self._body_names[body]

    # ---- lights and cameras -------------------------------------------------------------------------

    def _update_lights(self) -> None:
        shown = self.visual.lights[: self.visual.nlight]
        found: set[str] = set()
        for light in shown:
            name = HEADLIGHT if light.headlight else self._light_name(int(light.id))
            made = light_fields(self.mujoco, self.model, light)
            if made is None:
                continue
            found.add(name)
            self._show_light(name, light_numbers(self.model, light), *made)
        for name in self._lights.keys() - found:
            self.scene.remove(self._lights.pop(name))
        ambient = tuple(sum((np.array(light.ambient, np.float64) for light in shown), np.zeros(3)).tolist())
        # An environment that the user has set stays, as does one of a picture.
        is_models = self.scene.environment is self._sky and (self._sky is None or self._sky.name == AMBIENT)
        if is_models and ambient != self._ambient:
            self.scene.environment = self._sky = environment_of(self.mujoco, self.model, shown)
        self._ambient = ambient

    def _show_light(self, name: str, numbers: tuple[float, ...], kind: type[Light], fields: dict[str, Any]) -> None:
        light = self._lights.get(name)
        if light is not None and type(light) is not kind:
            self.scene.remove(light)
            light = None
        if light is None:
            self._lights[name] = self.scene.add(kind(**fields, name=name))  # type: ignore[call-arg]
            self._light_fields[name] = numbers, fields
            return
        # A light that moves keeps its brightness, and one that was edited what the model hasn't changed since.
        old_numbers, old = self._light_fields[name]
        changed: dict[str, Any] = {field: fields[field] for field in ("position", "direction") if field in fields}
        if numbers != old_numbers:
            changed |= {field: value for field, value in fields.items() if not np.array_equal(value, old[field])}
            self._light_fields[name] = numbers, fields
        light.update(**changed)

    def _light_name(self, index: int) -> str:
        return self.model.light(index).name or f"light {index}"

    def camera(self, name: str = "", size: tuple[int, int] | None = None) -> Camera:
        """The camera of the latest `update`. size: width and height of the picture, for lenses with an aspect of
        their own."""
        left, right = self.visual.camera
        place = (np.array(left.pos, np.float64) + right.pos) / 2
        forward, up = upward(left.forward), upward(left.up)
        transform = np.eye(4)
        transform[:3, :3] = np.stack([np.cross(forward, up), up, -forward], axis=1)
        transform[:3, 3] = upward(place)
        near, top, bottom = (float(value) for value in (left.frustum_near, left.frustum_top, left.frustum_bottom))
        fields: dict[str, Any] = {"near": near, "transform": transform, "name": name, "ev100": 0.0}
        if left.orthographic:
            return Camera(orthographic_height=top - bottom, **fields)
        fields["vertical_fov"] = 2 * math.atan((top - bottom) / (2 * near))
        half, center = float(left.frustum_width), (left.frustum_center + right.frustum_center) / 2
        if half > 0:
            aspect = size[0] / size[1] if size else half / ((top - bottom) / 2)
            fields["pixel_aspect"] = aspect * (top - bottom) / (2 * half)
            fields["principal_point"] = ((half - center) / (2 * half), top / (top - bottom))
        return Camera(**fields)

    def add_cameras(self, data: Any) -> None:
        """Add the model's cameras, and without any have the scene seen by MuJoCo's free camera."""
        mujoco, model = self.mujoco, self.model
        for index in range(model.ncam):
            width, height = (int(value) for value in model.cam_resolution[index])
            self.aim(data, fixed_camera(mujoco, index))
            size = (width, height) if min(width, height) > 1 else None
            self.scene.add(self.camera(model.camera(index).name or f"camera {index}", size))
        if not model.ncam:
            self.aim(data, None)
            self.scene.camera = self.camera("free")

    def aim(self, data: Any, camera: Any) -> None:
        """Look through a camera of MuJoCo, and leave all else as it is."""
        mujoco = self.mujoco
        if camera is None:
            camera = mujoco.MjvCamera()
            mujoco.mjv_defaultFreeCamera(self.model, camera)
        mujoco.mjv_updateCamera(self.model, data, camera, self.visual)

    # ---- groups -------------------------------------------------------------------------------------

    def add_groups(self, data: Any) -> None:
        """Make a Group of each body with all that it carries, one of each joint, about whose z axis it turns, and one
        of each of MuJoCo's groups of geoms."""
        objects = self.mujoco.mjtObj
        members: dict[int, list[Any]] = {body: [] for body in range(self.model.nbody)}
        by_group: dict[int, list[Instance]] = {}
        for (owner, number, _), instance in self.instances.items():
            if owner in (objects.mjOBJ_GEOM, objects.mjOBJ_SITE):
                is_geom = owner == objects.mjOBJ_GEOM
                members[int((self.model.geom_bodyid if is_geom else self.model.site_bodyid)[number])].append(instance)
                if is_geom:
                    by_group.setdefault(int(self.model.geom_group[number]), []).append(instance)
        for index in range(self.model.nlight):
            light = self._lights.get(self._light_name(index))
            if light is not None and not isinstance(light, EnvironmentLight):
                members[int(self.model.light_bodyid[index])].append(light)
        for index, camera in enumerate(self.scene.cameras):
            members[int(self.model.cam_bodyid[index])].append(camera)
        joints = self._joints()
        used = dict.fromkeys(self._body_names, 1)  # bodies keep their names; joints of the same name get a number
        names = {joint: distinct(self.model.joint(joint).name, used) for some in joints.values() for joint in some}
        # Children have higher numbers than what carries them.
        for body in range(self.model.nbody - 1, 0, -1):
            inside = members[body]
            if body in joints:
                inside = [self._body_group(data, body, inside, {joint: names[joint] for joint in joints[body]})]
            members[int(self.model.body_parentid[body])] += inside
        for number, instances in sorted(by_group.items()):
            self._group(instances, distinct(f"geom group {number}", used), np.eye(4))

    def _joints(self) -> dict[int, list[int]]:
        """The bodies that get groups, and the joints of each that do."""
        model = self.model
        found: dict[int, list[int]] = {}
        levels = np.zeros(model.nbody, int)
        for body in range(1, model.nbody):
            first = int(model.body_jntadr[body])
            joints = [
                joint
                for joint in range(first, first + int(model.body_jntnum[body]))
                if model.jnt_type[joint] != self.mujoco.mjtJoint.mjJNT_FREE and model.joint(joint).name
            ]
            above = levels[model.body_parentid[body]]
            fits = above + 1 + len(joints) <= MOST_LEVELS
            levels[body] = above + 1 + len(joints) if fits else above
            if fits:
                found[body] = joints
        left_out = model.nbody - 1 - len(found)
        if left_out:
            self.scene.warnings.append(
                f"{left_out} bodies have no group of their own, but move with that of a body above them: groups are "
                f"{MOST_LEVELS} levels deep at most"
            )
        return found

    def _body_group(self, data: Any, body: int, items: list[Any], joints: dict[int, str]) -> Group:
        """The group of a body, or the outermost one of its joints, which hold each other."""
        group = self._group(items, self.body_name(body), pose(data.xpos[body], data.xmat[body]))
        for joint, name in reversed(joints.items()):
            group = self._group([group], name, pose(data.xanchor[joint], _frame(data.xaxis[joint])))
        return group

    def _group(self, items: list[Any], name: str, transform: NDArray[np.float64]) -> Group:
        """A group of what is in the scene; `Scene.group` would look for each object in it."""
        group = Group(items, name=name, transform=transform)
        self.scene._groups[group] = None
        return group


def _frame(axis: Any) -> NDArray[np.float64]:
    """Axes (3, 3), as columns, of which z is the given one."""
    z = np.asarray(axis, np.float64)
    side = np.cross(z, np.eye(3)[np.abs(z).argmin()])
    side /= np.linalg.norm(side)
    return np.stack([side, np.cross(z, side), z], axis=1)


def fixed_camera(mujoco: Any, index: int) -> Any:
    """The MjvCamera of a camera of the model, by its number."""
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
    camera.fixedcamid = index
    return camera


def model_scene(
    model: Any, data: Any = None, name: str = "", *, who: str = "", finish: Callable[[ModelScene], None] | None = None
) -> ModelScene:
    """A model in a state, by default its initial one, with cameras and groups. who: the file, for messages. finish:
    what is done before groups are made. Raises SolariError for a state with numbers that aren't finite."""
    made = ModelScene(model, name)
    mujoco = made.mujoco
    if data is None:
        data = mujoco.MjData(model)
        # What poses depend on, and nothing of what moves them.
        for step in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_camlight, mujoco.mj_flex, mujoco.mj_tendon):
            step(model, data)
    check_data(mujoco, model, data)
    if not (np.isfinite(data.xpos).all() and np.isfinite(data.geom_xpos).all()):
        raise SolariError(f"{who or 'a model of MuJoCo'}: has poses that aren't finite: mend the numbers of its bodies")
    made.update(data, fixed_camera(mujoco, 0) if model.ncam else None)
    made.add_cameras(data)
    if finish is not None:
        finish(made)
    made.add_groups(data)
    return made
