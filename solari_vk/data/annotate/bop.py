"""Data sets in the format of the BOP benchmark: rigid objects with their poses before the camera, in millimeters.

Hodan et al., "BOP: Benchmark for 6D Object Pose Estimation" (2018), and the format's page in bop_toolkit.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, checked_constructor
from solari_vk.base.files import make_folder, read_json, write_whole
from solari_vk.data.annotate.boxes import box_around
from solari_vk.data.annotate.silhouettes import Silhouette
from solari_vk.output.kitti import png_16
from solari_vk.output.picture import png_bytes
from solari_vk.scene.matrices import unit
from solari_vk.scene.model import Camera, Instance, Mesh
from solari_vk.scene.objects import objects_of

MM = 1000.0
DEPTH_SCALE = 0.1  # millimeters of a step, while the picture is less deep than 6.5 m, the largest number of 16 bits
SAME_SIZE = 1e-4  # difference of a mesh's stretch, over the largest, up to which instances have one model
NOTHING = [-1, -1, -1, -1]
UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # models of BOP stand along z
KINDS = {b"\x89PNG": ".png", b"\xff\xd8\xff": ".jpg"}  # by how files begin


class _Part(NamedTuple):
    mesh: Mesh
    stretch: NDArray[np.float64]  # (3, 3), from the mesh's space to the model's axes
    shift: NDArray[np.float64]  # (3,), there from the first part's origin

    def is_like(self, other: _Part) -> bool:
        """Whether both have one mesh and one place in the model."""
        tolerance = SAME_SIZE * max(np.abs(self.stretch).max(), np.abs(self.shift).max())
        stretches_differ = np.abs(self.stretch - other.stretch).max()
        shifts_differ = np.abs(self.shift - other.shift).max()
        return self.mesh is other.mesh and max(stretches_differ, shifts_differ) <= tolerance


class _Model(NamedTuple):
    number: int
    parts: list[_Part]
    name: str
    label: str


@checked_constructor
class BopWriter:
    """Writes a scene of a BOP data set, picture by picture.

    folder: of the data set; its models go to `models`, the scene to SPLIT/000000. bop_toolkit looks for .jpg pictures
    in splits of the type "pbr" ("train_pbr"), and for .png in others. instances: the objects, by their numbers in
    `instance_id`; labels: their classes, by default their own. Parts of one object (`Instance.part_of`) are one model.
    What has one mesh and one scale is one object; scenes from scene_id 1 on keep the numbers of objects that the folder
    has from the scenes before. A model's origin is the middle of its box, and z is up. Raises
    SolariError for instances whose joints or morph targets move, which aren't rigid.
    """

    def __init__(
        self,
        folder: str | os.PathLike[str],
        instances: Mapping[int, Instance],
        *,
        labels: Mapping[int, str] | None = None,
        split: str = "train",
        scene_id: int = 0,
    ) -> None:
        self._labels = {number: instance.label for number, instance in instances.items()} | dict(labels or {})
        self._root = Path(folder)
        self._scene = self._root / split / f"{scene_id:06}"
        self._kind = ".jpg" if split.endswith("_pbr") else ".png"
        self._size: tuple[int, int] | None = None
        self._instances = dict(instances)
        self._models = list[_Model]()
        models = self._root / "models"
        goes_on = scene_id > 0 and (self._root / "objects.json").exists()
        self._infos_of_others = read_json(models / "models_info.json", "models") if goes_on else {}
        self._names_of_others = read_json(self._root / "objects.json", "objects") if goes_on else {}
        numbers = map(int, self._infos_of_others)
        self._files_of_others = {(models / _file(number)).read_text(): number for number in numbers}
        self._objects = objects_of(self._instances, self._labels)
        self._of = {number: self._model(number) for number in self._objects}
        # The rows of scene_camera.json, scene_gt.json and scene_gt_info.json, by the number of the picture.
        self._cameras: dict[str, Any] = {}
        self._poses: dict[str, Any] = {}
        self._infos: dict[str, Any] = {}

    def _model(self, number: int) -> _Model:
        parts = list[_Part]()
        for instance in self._parts(number):
            if instance.posed:
                raise SolariError(
                    f"BOP: {instance.describe()} is moved by joints or morph targets, and BOP has rigid "
                    "objects: take its label away"
                )
            if not parts:
                first = instance
                axes = UP @ first.rotation.T
            # A part of an object is placed relative to the first one, in the object's axes: the object's own pose is
            # left out, so that equal objects in other places have one model.
            shift = axes @ (instance.transform[:3, 3] - first.transform[:3, 3])
            parts.append(_Part(instance.mesh, axes @ instance.transform[:3, :3], shift))
        for model in self._models:
            if len(parts) == len(model.parts) and all(map(_Part.is_like, parts, model.parts)):
                return model
        name = first.part_of if len(parts) > 1 else first.name
        used = [*self._files_of_others.values(), *(model.number for model in self._models)]
        model = _Model(max(used, default=0) + 1, parts, name, self._labels[number])
        if self._files_of_others:
            known = self._files_of_others.get(_ply(_placed(model)[0], model))
            model = model if known is None else model._replace(number=known)
        self._models.append(model)
        return model

    def _parts(self, number: int) -> list[Instance]:
        return [self._instances[part] for part in self._objects[number]]

    def check(self, camera: Camera) -> None:
        """Raise SolariError if `add` would refuse this camera, or the visible instances as they are now."""
        _check_camera(camera)
        for number in self._objects:
            if any(part.visible for part in self._parts(number)):
                self._check_model(number)

    def _check_model(self, number: int) -> None:
        if self._model(number) is not self._of[number]:
            raise SolariError(
                f"BOP: {self._instances[number].describe()} has another size than in other pictures, and "
                "an object has one: leave its scale, and its parts' places, as they are"
            )

    def add(
        self, number: int, camera: Camera, picture: bytes, depth: NDArray[Any], silhouettes: Mapping[int, Silhouette]
    ) -> None:
        """Add a picture with this number.

        picture: the content of a file of the split's kind. depth (height, width): along the view axis in meters, inf
        for nothing. silhouettes: of the objects by their first part's number, from `silhouettes(around=1, merge=True)`;
        those that aren't visible have none. Raises SolariError for cameras that have no matrix K alone, for pictures of
        another kind, and for an object that has another scale than at first.
        """
        _check_camera(camera)
        if not any(picture.startswith(start) for start, kind in KINDS.items() if kind == self._kind):
            raise SolariError(
                f"BOP: pictures of the split {self._scene.parent.name} are {self._kind} files, as "
                f"bop_toolkit's paths have them: give one, or another split"
            )
        for name in ("rgb", "depth", "mask", "mask_visib"):
            make_folder(self._scene / name)
        size = depth.shape[1], depth.shape[0]
        self._size = self._size or size
        # 0 stands for no depth. A deeper picture has larger steps, so that 16 bits reach to its farthest point.
        depth_mm = np.where(np.isfinite(depth), depth, 0.0) * MM
        scale = max(DEPTH_SCALE, float(depth_mm.max()) / (2**16 - 1))
        rotation, shift = camera.extrinsics()
        self._cameras[str(number)] = {
            "cam_K": _numbers(camera.intrinsics(size)),
            "depth_scale": scale,
            "cam_R_w2c": _numbers(rotation),
            "cam_t_w2c": _numbers(shift * MM),
        }
        write_whole(self._scene / "rgb" / f"{number:06}{self._kind}", picture)
        write_whole(self._scene / "depth" / f"{number:06}.png", png_16(np.rint(depth_mm / scale).astype(np.uint16)))
        rows = sorted(set(silhouettes) & set(self._objects))
        self._poses[str(number)] = [self._pose(row, camera, size) for row in rows]
        self._infos[str(number)] = [_info(silhouettes[row], depth) for row in rows]
        for index, row in enumerate(rows):
            # Masks are named by the picture and by the row of the object in scene_gt.json.
            name = f"{number:06}_{index:06}.png"
            for kind, mask in (("mask", silhouettes[row].mask), ("mask_visib", silhouettes[row].visible)):
                write_whole(self._scene / kind / name, png_bytes(np.where(mask, 255, 0).astype(np.uint8)))

    def _pose(self, number: int, camera: Camera, size: tuple[int, int]) -> dict[str, Any]:
        """An object's row of scene_gt.json: the pose from its model to the camera."""
        self._check_model(number)
        box = box_around(self._parts(number), camera, size)
        return {
            "cam_R_m2c": _numbers(box.rotation @ UP.T),
            "cam_t_m2c": _numbers(box.center * MM),
            "obj_id": self._of[number].number,
        }

    def finish(self) -> None:
        """Write the scene's tables and the models. Raises SolariError for a file that can't be written."""
        make_folder(self._scene)
        make_folder(self._root / "models")
        for name, table in (("camera", self._cameras), ("gt", self._poses), ("gt_info", self._infos)):
            write_whole(self._scene / f"scene_{name}.json", _json(table))
        if self._size is not None:
            write_whole(self._root / "camera.json", json.dumps(self._first_camera(self._size)))
        infos = dict(self._infos_of_others)
        names = dict(self._names_of_others)
        for model in self._models:
            points, infos[str(model.number)] = _placed(model)
            names[str(model.number)] = {"name": model.name, "label": model.label}
            write_whole(self._root / "models" / _file(model.number), _ply(points, model))
        write_whole(self._root / "models" / "models_info.json", _json(infos))
        write_whole(self._root / "objects.json", _json(names))

    def _first_camera(self, size: tuple[int, int]) -> dict[str, float]:
        """The first picture's, as a data set's camera.json has it."""
        first = next(iter(self._cameras.values()))
        fx, _, cx, _, fy, cy, *_ = first["cam_K"]
        return {
            "width": size[0],
            "height": size[1],
            "fx": fx,
            "fy": fy,
            "cx": cx,
            "cy": cy,
            "depth_scale": first["depth_scale"],
        }


def _check_camera(camera: Camera) -> None:
    if camera.has_lens or camera.orthographic_height:
        raise SolariError(f"BOP: {camera.describe()}: cameras are perspective and without distortion")


def _info(silhouette: Silhouette, depth: NDArray[Any]) -> dict[str, Any]:
    """As bop_toolkit's calc_gt_info computes it; its boxes' widths don't count the last pixel."""
    x, y, width, height = silhouette.box
    rows, columns = np.nonzero(silhouette.visible)
    seen = len(rows) > 0
    corner = [int(columns.min()), int(rows.min())] if seen else []
    return {
        "px_count_all": silhouette.pixel_count,
        "px_count_visib": len(rows),
        "visib_fract": silhouette.fraction,
        "px_count_valid": int((silhouette.mask & np.isfinite(depth)).sum()),
        "bbox_obj": [x, y, width - 1, height - 1] if seen else NOTHING,
        "bbox_visib": [*corner, int(np.ptp(columns)), int(np.ptp(rows))] if seen else NOTHING,
    }


def _file(number: int) -> str:
    return f"obj_{number:06}.ply"


def _placed(model: _Model) -> tuple[NDArray[np.float64], dict[str, float]]:
    """The vertices (N, 3) in millimeters about the middle of their box, and their row of models_info.json."""
    placed = [part.mesh.positions.astype(np.float64) @ part.stretch.T + part.shift for part in model.parts]
    points = np.concatenate(placed) * MM
    low, high = points.min(axis=0), points.max(axis=0)
    points = points - (low + high) / 2
    half = (high - low) / 2
    row = {"diameter": diameter(points)}
    for what, values in (("min", -half), ("size", 2 * half)):
        for axis, value in zip("xyz", values, strict=True):
            row[f"{what}_{axis}"] = float(value)
    return points, row


def diameter(points: NDArray[np.float64]) -> float:
    """The largest distance between two of the points (N, 3)."""
    points = np.unique(points, axis=0)
    radii = np.linalg.norm(points - points.mean(axis=0), axis=1)
    # The point farthest from the mean is in a pair that is at least so far apart.
    far = points[radii.argmax()]
    least = max(float(np.linalg.norm(points - far, axis=1).max()), 0.0)
    # By the triangle inequality through the mean, a point nearer to it than this is in no pair that far apart. That
    # leaves a few hundred of a usual mesh's points, all pairs of which are compared, 256 points at a time.
    points = points[radii >= least - radii.max() - 1e-9]
    largest = least
    for start in range(0, len(points), 256):
        apart = points[start : start + 256, None] - points[None, start:]
        largest = max(largest, float(np.sqrt(np.einsum("abi,abi->ab", apart, apart).max())))
    return largest


def _normals(part: _Part) -> NDArray[np.float64]:
    """Unit normals (N, 3) of the vertices in the model's axes: the mesh's, or the mean of its triangles'."""
    mesh = part.mesh
    if mesh.normals is not None:
        found = mesh.normals.astype(np.float64)
    else:
        a, b, c = np.moveaxis(mesh.positions.astype(np.float64)[mesh.triangles], 1, 0)
        found = np.zeros(mesh.positions.shape)
        # The cross product is as long as the triangle is large, so the mean is weighted by area.
        np.add.at(found, mesh.triangles, np.cross(b - a, c - a)[:, None])
    # Normals go by the inverse transpose of what positions go by.
    found = found @ np.linalg.inv(part.stretch)
    return unit(found)


def _ply(points: NDArray[np.float64], model: _Model) -> str:
    names = ("x", "y", "z", "nx", "ny", "nz")
    normals = np.concatenate([_normals(part) for part in model.parts])
    triangles = np.zeros((0, 3), np.int64)
    vertex_count = 0
    for part in model.parts:
        corners = part.mesh.triangles
        # A stretch that mirrors would turn the triangles' fronts inwards.
        if np.linalg.det(part.stretch) < 0:
            corners = corners[:, ::-1]
        triangles = np.concatenate([triangles, corners + vertex_count])
        vertex_count += len(part.mesh.positions)
    head = [
        "ply",
        "format ascii 1.0",
        f"element vertex {len(points)}",
        *(f"property float {name}" for name in names),
        f"element face {len(triangles)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    rows = [" ".join(f"{value:.6g}" for value in row) for row in np.concatenate([points, normals], axis=1).tolist()]
    return "\n".join([*head, *rows, *(f"3 {a} {b} {c}" for a, b, c in triangles.tolist()), ""])


def _numbers(array: NDArray[np.float64]) -> list[float]:
    return [float(value) for value in array.ravel()]


def _json(table: Mapping[str, Any]) -> str:
    """A JSON object with one key a line."""
    return "{\n" + ",\n".join(f"  {json.dumps(key)}: {json.dumps(value)}" for key, value in table.items()) + "\n}\n"
