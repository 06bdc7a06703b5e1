"""Cameras of COLMAP's text files, cameras.txt and images.txt: Schönberger and Frahm, "Structure-from-Motion Revisited"
(2016)."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from solari_vk.base.budget import charge, load_budget
from solari_vk.base.errors import SolariError
from solari_vk.base.files import make_folder, read_regular, text_lines, write_whole
from solari_vk.scene.camera import Camera
from solari_vk.scene.matrices import quaternion_rotation

# The parameters of each model after the focal lengths and the principal point, as places in OpenCV's distortion; and
# whether it has one focal length.
MODELS: Mapping[str, tuple[tuple[int, ...], bool]] = {
    "SIMPLE_PINHOLE": ((), True),
    "PINHOLE": ((), False),
    "SIMPLE_RADIAL": ((0,), True),
    "RADIAL": ((0, 1), True),
    "OPENCV": ((0, 1, 2, 3), False),
    "FULL_OPENCV": ((0, 1, 2, 3, 4, 5, 6, 7), False),
    "OPENCV_FISHEYE": ((0, 1, 2, 3), False),
}
_BYTES_PER_CAMERA = 2**13
_MOST_WORDS = 20  # of a camera: its number, model and size, and at most 12 parameters
_SHORTEST = 1e-100  # the least length of a quaternion, whose square is still a number
CENTER = 0.5  # COLMAP's position of the first pixel's center, which is 0 in OpenCV


class ColmapImage(NamedTuple):
    """An image of a COLMAP model: its file's name, its camera, and its size (width, height) in pixels."""

    name: str
    camera: Camera
    size: tuple[int, int]


def load_colmap(folder: str | os.PathLike[str]) -> list[ColmapImage]:
    """The images of a folder with `cameras.txt` and `images.txt`, in the file's order.

    Raises SolariError for a file that can't be read, a model that isn't in MODELS, and a wrong line.
    """
    with load_budget():
        return _load(Path(folder) / "cameras.txt", Path(folder) / "images.txt")


def _load(cameras: Path, path: Path) -> list[ColmapImage]:
    lenses = {}
    found = []
    for number, line in _lines(cameras):
        if line:
            words = line.split(maxsplit=_MOST_WORDS)
            charge(_BYTES_PER_CAMERA + 2 * sys.getsizeof(line), str(cameras), "its cameras")
            lenses[words[0]] = cameras, number, words[1:]
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


def _image(
    name: str, rotation: list[list[float]], shift: list[float], path: Path, number: int, words: list[str]
) -> ColmapImage:
    model = words[0] if words else ""
    if model not in MODELS:
        raise SolariError(f"{path}, line {number}: the camera model '{model}' isn't one of {', '.join(MODELS)}")
    places, is_simple = MODELS[model]
    try:
        size = int(words[1]), int(words[2])
        fx, *rest = (float(word) for word in words[3:])
        # Simple models have one focal length for both axes.
        fy, cx, cy, *terms = [fx, *rest] if is_simple else rest
        distortion = np.zeros(8)
        for place, term in zip(places, terms, strict=True):
            distortion[place] = term
    except (ValueError, IndexError):
        count = (3 if is_simple else 4) + len(places)
        raise SolariError(
            f"{path}, line {number}: a camera of the model {model} has a size and {count} parameters"
        ) from None
    fisheye = model == "OPENCV_FISHEYE"
    matrix = np.array([[fx, 0, cx - CENTER], [0, fy, cy - CENTER], [0, 0, 1]])
    try:
        camera = Camera.from_opencv(
            matrix,
            rotation,
            shift,
            size,
            distortion[:4] if fisheye else distortion,
            projection="fisheye" if fisheye else "perspective",
            name=name,
        )
    except SolariError as error:
        raise SolariError(f"{path}, line {number}: {error}") from None
    return ColmapImage(name, camera, size)


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
    parameters = fx, fy, cx + CENTER, cy + CENTER, *distortion[: len(MODELS[model][0])]
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
