"""`sv.mujoco.Batch`: the cameras of many worlds of one model of MuJoCo, lit in one frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import ExitStack
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import Hints, SolariError, checked_constructor, quoted, warn
from solari_vk.batch import batch as batches
from solari_vk.gpu.acceleration.checks import whole_number
from solari_vk.gpu.device.device import Device
from solari_vk.robots.poses import on_device, scene_poses
from solari_vk.scene.files.mujoco.model_scene import ModelScene, check_data, model_scene
from solari_vk.scene.model import Camera, Instance, Scene

KINDS = {"geom": "mjOBJ_GEOM", "site": "mjOBJ_SITE"}


@checked_constructor
class Batch(Hints):
    """Pictures of the cameras of many worlds of a model. A context manager.

    model: an MjModel. worlds: their number N. height, width: of a view in pixels. cameras: names or numbers of the
    model's cameras, by default all C of them, or MuJoCo's free camera for a model without. device: one that is open,
    else the batch opens its own. renderer, outputs and further options are those of `sv.Batch`, by default the denoised
    realtime light without outputs beside it. ev100: the exposure of "display".

    `scene` has an instance for each geom, `batch` is the `sv.Batch` of the N C views, whose `world_materials` and
    `world_lights` give worlds their own. Lights stay where they are in the model's initial state, the headlight along
    the first camera; tendons, skins and flexes are left out. Raises SolariError for unknown cameras and options.
    """

    def __init__(
        self,
        model: Any,
        worlds: int,
        height: int = 64,
        width: int = 64,
        *,
        cameras: Sequence[str | int] | None = None,
        device: Device | None = None,
        renderer: str = "realtime",
        outputs: Sequence[str] = (),
        ev100: float = 0.0,
        **options: Any,
    ) -> None:
        self.model = model
        self.worlds = whole_number(worlds, "mujoco.Batch: worlds", 1)
        self._ev100 = ev100
        shown = model_scene(model)
        self.scene: Scene = shown.scene
        self._numbers = _camera_numbers(shown, cameras)
        self.cameras: list[Camera] = [self.scene.cameras[number] for number in self._numbers] or [self.scene.camera]
        """The cameras of a world, in the model's initial state."""
        self._moving = _moving_instances(shown)
        self._mujoco = shown.mujoco
        self._lens = np.tile([_lens(camera, width, height) for camera in self.cameras], (self.worlds, 1, 1))
        if not len(self.scene):
            raise SolariError("mujoco.Batch: the model has no geoms that are shown: give it some, in groups 0 to 2")
        self._owned = ExitStack()
        try:
            self._device = self._owned.enter_context(Device()) if device is None else device
            views = self.worlds * len(self.cameras)
            kind: dict[str, Any] = {"renderer": renderer, "outputs": tuple(outputs), "worlds": self.worlds, **options}
            self.batch = self._owned.enter_context(
                batches.Batch(self._device, self.scene, (width, height), views, **kind)
            )
            self.segmentation_table = self._segmentation_table(shown)
            """(M, 2): the number and the mjtObj of the object with each "instance_id"; the last row, -1, is the
            background's."""
        except BaseException:
            self._owned.close()
            raise

    def _segmentation_table(self, shown: ModelScene) -> NDArray[np.int32]:
        keys = {instance: key for key, instance in shown.instances.items()}
        table = np.full((max(self.batch.instances) + 2, 2), -1, np.int32)
        for number, instance in self.batch.instances.items():
            table[number] = keys[instance][1], keys[instance][0]
        return table

    def render(self, data: Any, **options: Any) -> Self:
        """Render all views of N states, and return this batch.

        data: a list of N MjData, a single one for one world, or an object or a dict with `geom_xpos` (N, geoms, 3) and
        `geom_xmat` (N, geoms, 3, 3) or (N, geoms, 9), and for cameras `cam_xpos` and `cam_xmat`, such as the Data of
        MuJoCo Warp or of MJX; sites move where it has `site_xpos` and `site_xmat`, and geoms of the world body never.
        Arrays of Warp, and others on a GPU where Warp is installed, stay on it, and are float32. options: samples,
        seeds, reset and reset_cache of `sv.Batch.render`. Raises SolariError for states that don't fit the model, and
        as `sv.Batch.render`.
        """
        data = [data] if isinstance(data, self._mujoco.MjData) else data
        for state in data if isinstance(data, (list, tuple)) else ():
            check_data(self._mujoco, self.model, state)
        for kind, (instances, numbers) in self._moving.items():
            found = self._poses(data, kind, numbers)
            if found is not None:
                self._move(instances, found)
        cameras = self._poses(data, "cam", self._numbers) if self._numbers else None
        if cameras is None:
            cameras = np.tile([camera.transform for camera in self.cameras], (self.worlds, 1, 1))
        near = self.cameras[0].near
        views = cameras.reshape((self.batch.views, 4, 4))
        self.batch.render(views, K=self._lens, near=near, ev100=self._ev100, **options)
        return self

    def _poses(self, data: Any, kind: str, numbers: Sequence[int]) -> Any:
        """Transforms (N, numbers, 4, 4), of Warp where the state is; None where the data has none of sites."""
        places, axes = (_field(data, f"{kind}_{name}") for name in ("xpos", "xmat"))
        if places is None or axes is None:
            if kind == "geom":
                raise SolariError(
                    "mujoco.Batch.render: the state has no geom_xpos and geom_xmat: give MjData or its like"
                )
            return None
        count = int(getattr(self.model, f"n{kind}"))
        shape = tuple(places.shape)
        if shape not in ((self.worlds, count, 3), (self.worlds, count)):  # Warp counts a vector as one
            raise SolariError(
                f"mujoco.Batch.render: {kind}_xpos has the shape {shape}, where {self.worlds} worlds of the model have "
                f"({self.worlds}, {count}, 3)"
            )
        turns = tuple(axes.shape)
        if turns not in ((*shape[:2], 3, 3), (*shape[:2], 9), shape[:2]) or on_device(axes) != on_device(places):
            raise SolariError(
                f"mujoco.Batch.render: {kind}_xmat has the shape {turns}, where the model has ({self.worlds}, {count}, "
                f"3, 3) beside {kind}_xpos"
            )
        if on_device(places):
            return scene_poses(places, axes, numbers)
        places = np.asarray(places, np.float64).reshape(self.worlds, count, 3)[:, numbers]
        axes = np.asarray(axes, np.float64).reshape(self.worlds, count, 3, 3)[:, numbers]
        return scene_poses(places, axes, numbers)

    def _move(self, instances: list[Instance], transforms: Any) -> None:
        if self.worlds > 1:
            self.batch.transforms[instances] = transforms
            return
        found = transforms.numpy() if hasattr(transforms, "numpy") else transforms
        for instance, transform in zip(instances, found[0], strict=True):
            instance.transform = transform

    def __getitem__(self, name: str) -> NDArray[Any]:
        """A copy of a result (N, C, height, width[, channels]): of `sv.Batch`, or "segmentation" (..., 2), from
        "instance_id" by `segmentation_table`."""
        if name == "segmentation":
            numbers = self["instance_id"]
            found: NDArray[Any] = self.segmentation_table[np.minimum(numbers, len(self.segmentation_table) - 1)]
            return found
        values = self.batch[name]
        return values.reshape(self.worlds, len(self.cameras), *values.shape[1:])

    def tensor(self, name: str) -> Any:
        """A result that stays on the device, (N, C, height, width[, channels]), for `torch.from_dlpack` and the like:
        see `sv.Batch.tensor`."""
        values = self.batch.tensor(name)
        return values.reshape(self.worlds, len(self.cameras), *values.shape[1:])

    def close(self) -> None:
        """Free everything on the device. Safe to call twice."""
        self._owned.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _camera_numbers(shown: ModelScene, cameras: Sequence[str | int] | None) -> list[int]:
    model = shown.model
    if cameras is None:
        return list(range(model.ncam))
    found = []
    for camera in [cameras] if isinstance(cameras, (str, int)) else cameras:
        number = camera
        if isinstance(camera, str):
            number = shown.mujoco.mj_name2id(model, shown.mujoco.mjtObj.mjOBJ_CAMERA, camera)
        if not isinstance(number, (int, np.integer)) or not 0 <= number < model.ncam:
            names = ", ".join(model.camera(index).name or str(index) for index in range(model.ncam)) or "no cameras"
            raise SolariError(f"mujoco.Batch: there is no camera {quoted(camera)}: the model has {names}")
        found.append(int(number))
    return found


def _moving_instances(shown: ModelScene) -> dict[str, tuple[list[Instance], list[int]]]:
    """By kind the instances of geoms and sites of bodies other than the world, and their numbers. What has no poses is
    removed."""
    mujoco, model = shown.mujoco, shown.model
    owners = {int(getattr(mujoco.mjtObj, name)): kind for kind, name in KINDS.items()}
    found: dict[str, tuple[list[Instance], list[int]]] = {kind: ([], []) for kind in KINDS}
    left_out = []
    for (owner, number, _), instance in list(shown.instances.items()):
        kind = owners.get(owner)
        if kind is None:
            left_out.append(instance)
        elif getattr(model, f"{kind}_bodyid")[number]:  # bodies without joints too: worlds may have their own poses
            found[kind][0].append(instance)
            found[kind][1].append(number)
    for instance in left_out:
        shown.scene.remove(instance)
    if left_out:
        warn(f"mujoco.Batch: worlds have no {', '.join(sorted({one.mesh.name or one.name for one in left_out}))}")
    return {kind: pair for kind, pair in found.items() if pair[0]}


def _field(data: Any, name: str) -> Any:
    if isinstance(data, (list, tuple)):
        return np.array([getattr(one, name) for one in data])
    found = data.get(name) if isinstance(data, dict) else getattr(data, name, None)
    if found is None or on_device(found):
        return found
    try:
        return np.asarray(found, np.float64)
    except (TypeError, ValueError):
        raise SolariError(f"mujoco.Batch.render: {name} isn't an array of numbers") from None


def _lens(camera: Camera, width: int, height: int) -> NDArray[np.float64]:
    """OpenCV's matrix (3, 3) of a view."""
    if camera.orthographic_height:
        raise SolariError(f"mujoco.Batch: {camera.describe()} is orthographic, which worlds can't be: leave it out")
    focal = height / 2 / math.tan(camera.vertical_fov / 2)
    # OpenCV counts pixels from the middle of the first one.
    x, y = camera.principal_point * (width, height) - 0.5
    return np.array([(focal * camera.pixel_aspect, 0, x), (0, focal, y), (0, 0, 1)])
