"""Cameras of COLMAP's files, cameras and images as .txt or .bin: Schönberger and Frahm, "Structure-from-Motion
Revisited" (2016)."""

from __future__ import annotations

import math
import os
import struct
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from solari_vk.base.budget import charge, load_budget
from solari_vk.base.errors import SolariError, checked_keywords
from solari_vk.base.files import make_folder, read_regular, text_lines, write_whole
from solari_vk.scene.camera import Camera
from solari_vk.scene.matrices import quaternion_rotation


class Model(NamedTuple):
    """A camera model. number: in binary files. places: in OpenCV's distortion, of the parameters after the focal
    lengths and the principal point. must_be_0: the places of those that cameras here don't have."""

    number: int
    places: tuple[int, ...] = ()
    is_simple: bool = False
    """With one focal length for both axes."""
    is_fisheye: bool = False
    must_be_0: tuple[int, ...] = ()


MODELS: Mapping[str, Model] = {
    "SIMPLE_PINHOLE": Model(0, is_simple=True),
    "PINHOLE": Model(1),
    "SIMPLE_RADIAL": Model(2, (0,), is_simple=True),
    "RADIAL": Model(3, (0, 1), is_simple=True),
    "OPENCV": Model(4, (0, 1, 2, 3)),
    "FULL_OPENCV": Model(6, (0, 1, 2, 3, 4, 5, 6, 7)),
    "OPENCV_FISHEYE": Model(5, (0, 1, 2, 3), is_fisheye=True),
    "SIMPLE_RADIAL_FISHEYE": Model(8, (0,), is_simple=True, is_fisheye=True),
    "RADIAL_FISHEYE": Model(9, (0, 1), is_simple=True, is_fisheye=True),
    # k1, k2, p1, p2, k3, k4, sx1, sy1: of the tangential terms and the thin prism, cameras here have none.
    "THIN_PRISM_FISHEYE": Model(10, (0, 1, 4, 5, 2, 3, 6, 7), is_fisheye=True, must_be_0=(4, 5, 6, 7)),
}
_BYTES_PER_CAMERA = 2**13
_MOST_WORDS = 20  # of a camera: its number, model and size, and at most 12 parameters
_SHORTEST = 1e-100  # the least length of a quaternion, whose square is still a number
_POINT_BYTES = 24  # of a point in an image: its place and its number
CENTER = 0.5  # COLMAP's position of the first pixel's center, which is 0 in OpenCV


class ColmapImage(NamedTuple):
    """An image of a COLMAP model: its file's name, its camera, and its size (width, height) in pixels."""

    name: str
    camera: Camera
    size: tuple[int, int]


@checked_keywords(who="solari_vk")
def load_colmap(folder: str | os.PathLike[str]) -> list[ColmapImage]:
    """The images of a folder with `cameras.bin` and `images.bin`, or else `cameras.txt` and `images.txt`, in the file's
    order.

    Raises SolariError for a file that can't be read, a model that isn't in MODELS, and a wrong line.
    """
    with load_budget():
        if all((Path(folder) / name).exists() for name in ("cameras.bin", "images.bin")):
            return _load_binary(Path(folder))
        return _load(Path(folder) / "cameras.txt", Path(folder) / "images.txt")


def _load(cameras: Path, path: Path) -> list[ColmapImage]:
    lenses = {}
    found = []
    for number, line in _lines(cameras):
        if line:
            words = line.split(maxsplit=_MOST_WORDS)
            charge(_BYTES_PER_CAMERA + 2 * sys.getsizeof(line), str(cameras), "its cameras")
            lenses[words[0]] = f"{cameras}, line {number}", words[1:]
    for number, line in islice(_lines(path), 0, None, 2):  # a line of an image's points follows its own
        words = line.split(maxsplit=9)
        if not words:
            continue
        try:
            # COLMAP's quaternions have w first, and turn from the world to the camera.
            w, x, y, z, *shift = (float(word) for word in words[1:8])
            camera_id = words[8]
            name = words[9]
        except (ValueError, IndexError):
            raise SolariError(
                f"{path}, line {number}: an image is IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, not '{line[:80]}'"
            ) from None
        if camera_id not in lenses:
            raise SolariError(f"{path}, line {number}: there is no camera {camera_id} in cameras.txt")
        length = math.hypot(w, x, y, z)
        if not _SHORTEST < length < math.inf:
            raise SolariError(f"{path}, line {number}: the quaternion QW QX QY QZ is no rotation: export it again")
        rotation = quaternion_rotation(x / length, y / length, z / length, w / length)
        charge(_BYTES_PER_CAMERA + 2 * sys.getsizeof(line), str(path), "its images")
        found.append(_image(name, rotation, shift, *lenses[camera_id]))
    return found


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    for number, line in text_lines(read_regular(path, str(path)), str(path)):
        if not line.lstrip().startswith("#"):
            yield number, line.strip()


def _image(name: str, rotation: list[list[float]], shift: list[float], where: str, words: list[str]) -> ColmapImage:
    name_of_model = words[0] if words else ""
    if name_of_model not in MODELS:
        raise SolariError(f"{where}: the camera model '{name_of_model}' isn't one of {', '.join(MODELS)}")
    model = MODELS[name_of_model]
    try:
        size = int(words[1]), int(words[2])
        fx, *rest = (float(word) for word in words[3:])
        # Simple models have one focal length for both axes.
        fy, cx, cy, *terms = [fx, *rest] if model.is_simple else rest
        distortion = np.zeros(8)
        for place, term in zip(model.places, terms, strict=True):
            distortion[place] = term
    except (ValueError, IndexError):
        count = _parameter_count(model)
        raise SolariError(f"{where}: a camera of the model {name_of_model} has a size and {count} parameters") from None
    if distortion[list(model.must_be_0)].any():
        raise SolariError(
            f"{where}: {name_of_model} with tangential or thin prism terms can't be shown: undistort the images, or "
            "calibrate them as OPENCV_FISHEYE"
        )
    matrix = np.array([[fx, 0, cx - CENTER], [0, fy, cy - CENTER], [0, 0, 1]])
    try:
        camera = Camera.from_opencv(
            matrix,
            rotation,
            shift,
            size,
            distortion,
            projection="fisheye" if model.is_fisheye else "perspective",
            name=name,
        )
    except SolariError as error:
        raise SolariError(f"{where}: {error}") from None
    return ColmapImage(name, camera, size)


def _parameter_count(model: Model) -> int:
    return (3 if model.is_simple else 4) + len(model.places)


def _load_binary(folder: Path) -> list[ColmapImage]:
    names = {model.number: name for name, model in MODELS.items()}
    lenses = {}
    file = _Binary(folder / "cameras.bin")
    for _ in range(file.take("Q")[0]):
        charge(_BYTES_PER_CAMERA, str(file.path), "its cameras")
        camera_id, number, width, height = file.take("iiQQ")
        if number not in names:
            raise SolariError(f"{file.path}: camera {camera_id} has the model {number}, not one of {', '.join(MODELS)}")
        parameters = file.take("d" * _parameter_count(MODELS[names[number]]))
        words = [names[number], *map(repr, (width, height, *parameters))]
        lenses[camera_id] = f"{file.path}, camera {camera_id}", words
    found = []
    file = _Binary(folder / "images.bin")
    for _ in range(file.take("Q")[0]):
        image_id, w, x, y, z, *shift, camera_id = file.take("i7di")
        name = file.text()
        charge(_BYTES_PER_CAMERA + 2 * sys.getsizeof(name), str(file.path), "its images")
        file.skip(_POINT_BYTES * file.take("Q")[0])
        length = math.hypot(w, x, y, z)
        if not _SHORTEST < length < math.inf or camera_id not in lenses:
            raise SolariError(f"{file.path}: image {image_id} has a wrong quaternion, or a camera that there isn't")
        rotation = quaternion_rotation(x / length, y / length, z / length, w / length)
        found.append(_image(name, rotation, shift, *lenses[camera_id]))
    return found


class _Binary:
    """A binary file, little-endian."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._data = read_regular(path, str(path))
        self._at = 0

    def take(self, kinds: str) -> tuple[Any, ...]:
        """The next numbers, as `struct` names their types."""
        start = self._at
        self.skip(struct.calcsize(f"<{kinds}"))
        return struct.unpack_from(f"<{kinds}", self._data, start)

    def text(self) -> str:
        """The text up to the next null character."""
        start = self._at
        self.skip(self._data.find(b"\0", start) + 1 - start)
        return self._data[start : self._at - 1].decode(errors="replace")

    def skip(self, count: int) -> None:
        if count < 0 or count > len(self._data) - self._at:
            raise SolariError(f"{self.path}: is cut off: export it again")
        self._at += count


@checked_keywords(who="solari_vk")
def save_colmap(
    folder: str | os.PathLike[str], cameras: Sequence[Camera], size: tuple[int, int], names: Sequence[str]
) -> None:
    """Write `cameras.txt`, `images.txt` and an empty `points3D.txt` for pictures of one size with these file names.

    Raises SolariError for another number of names, a camera that COLMAP has no model for (orthographic, stereographic,
    equirectangular, thin prism), and a folder that can't be written.
    """
    if len(names) != len(cameras):
        raise SolariError(f"save_colmap: {len(cameras)} cameras have {len(names)} names")
    lenses: dict[str, int] = {}
    images = []
    for number, (camera, name) in enumerate(zip(cameras, names, strict=True), 1):
        lens = lenses.setdefault(_lens(camera, size), len(lenses) + 1)
        rotation, shift = camera.extrinsics()
        pose = " ".join(f"{value:.17g}" for value in (*_quaternion(rotation), *shift))
        # An empty second line: no points of the picture.
        images.append(f"{number} {pose} {lens} {name}\n\n")
    make_folder(Path(folder))
    points = Path(folder) / "points3D.txt"
    if points.exists() and points.stat().st_size > 0:
        raise SolariError(f"{points}: has the points of another model, which would be lost: give another folder")
    lines = (f"{number} {lens}\n" for lens, number in lenses.items())
    write_whole(Path(folder) / "cameras.txt", "# CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]\n" + "".join(lines))
    header = "# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME\n# POINTS2D[] as X Y POINT3D_ID\n"
    write_whole(Path(folder) / "images.txt", header + "".join(images))
    write_whole(points, "")


def check_colmap(cameras: Iterable[Camera], size: tuple[int, int]) -> None:
    """Raise SolariError for a camera that COLMAP has no model for."""
    for camera in cameras:
        _lens(camera, size)


def _lens(camera: Camera, size: tuple[int, int]) -> str:
    """Model, size and parameters."""
    coefficients = camera.distortion.tolist()
    if camera.projection not in ("perspective", "fisheye") or len(coefficients) > 8:
        raise SolariError(
            f"save_colmap: {camera.describe()}: COLMAP has no model for this {camera.projection} camera "
            f"with {len(coefficients)} numbers of distortion"
        )
    distortion = [*coefficients, *[0.0] * 8][:8]
    if camera.projection == "fisheye":
        model = "OPENCV_FISHEYE"
    elif any(distortion[4:]):
        model = "FULL_OPENCV"
    else:
        model = "OPENCV" if coefficients else "PINHOLE"
    (fx, _, cx), (_, fy, cy), _ = camera.intrinsics(size).tolist()
    parameters = fx, fy, cx + CENTER, cy + CENTER, *distortion[: len(MODELS[model].places)]
    return " ".join((model, *map(str, size), *(f"{value:.17g}" for value in parameters)))


def _quaternion(rotation: np.ndarray) -> tuple[float, ...]:
    """w, x, y, z of a rotation: the eigenvector of Bar-Itzhack, "New Method for Extracting the Quaternion" (2000)."""
    # The largest eigenvalue's vector also fits a matrix that is a rotation only up to rounding.
    (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
    k = np.array(
        [
            [a - e - i, b + d, c + g, h - f],
            [b + d, e - a - i, f + h, c - g],
            [c + g, f + h, i - a - e, d - b],
            [h - f, c - g, d - b, a + e + i],
        ]
    )
    x, y, z, w = np.linalg.eigh(k)[1][:, -1].tolist()
    return (w, x, y, z) if w >= 0 else (-w, -x, -y, -z)
