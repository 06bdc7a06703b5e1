"""The environment of a glTF file: EXT_lights_image_based."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene.files.gltf.document import Document
from solari_vk.scene.files.gltf.images import Images
from solari_vk.scene.files.gltf.report import Report
from solari_vk.scene.files.gltf.values import Entry, is_index, shown
from solari_vk.scene.images.mip_chain import LINEAR_OF_SRGB
from solari_vk.scene.lights.environment import Environment, directions
from solari_vk.scene.matrices import nearest_rotation, quaternion_rotation

EXTENSION = "EXT_lights_image_based"
LARGEST_MAP = 2048  # texels around the horizon
_FACES = 6

Floats = NDArray[np.floating[Any]]


def read_environment(document: Document, scene: Entry, report: Report, strict: bool) -> Environment | None:
    """The environment that a scene of a file refers to; None without one, and (reported) for one without its images.

    It is the sharpest level of the file's cube, which holds what the others blur for rasterizers. Paths find diffuse
    light by themselves, so that the coefficients of irradiance aren't read.
    """
    user = scene.extension(EXTENSION)
    if user is None:
        return None
    root = document.root.extension(EXTENSION)
    lights = root.entries("lights", "light") if root else []
    number = user.integer("light")
    if number >= len(lights):
        raise scene.error(f"refers to light {shown(number)}, but the file has only {len(lights)} of them")
    light = lights[number]
    faces = _read_faces(light, Images(document, report, strict))
    if faces is None:
        report.add("environments whose images can't be read or aren't equal squares are left out", light.place)
        return None
    x, y, z, w = light.numbers("rotation", (0.0, 0.0, 0.0, 1.0), low=-1e6, high=1e6)
    turn = np.array(quaternion_rotation(x, y, z, w))
    return Environment(
        unroll_cube(faces),
        intensity=light.limited("intensity", 1.0, low=0, limit=1e9),
        rotation=nearest_rotation(turn) if turn.any() else np.eye(3),
        name=light.name,
    )


def _read_faces(light: Entry, images: Images) -> Floats | None:
    """The linear colors (6, N, N, 3) of the sharpest level; None if an image can't be read or has another size."""
    wanted = "a list of levels of six images"
    levels = light.values("specularImages", wanted, lambda level: isinstance(level, list))
    if not levels or len(levels[0]) != _FACES or not all(map(is_index, levels[0])):
        raise light.wrong("specularImages", wanted)
    choices = [(int(value),) for value in levels[0]]
    images.read(dict.fromkeys(choices, light))
    read = [images[choice] for choice in choices]
    pixels = [image.pixels for image in read if image is not None]
    if len(pixels) < _FACES or not are_equal_squares(pixels):
        return None
    return np.stack([decode_rgbd(face) for face in pixels])


def are_equal_squares(faces: Sequence[NDArray[Any]]) -> bool:
    """Whether pictures (H, W, channels) can be the faces of a cube."""
    side = len(faces[0])
    return all(face.shape[:2] == (side, side) for face in faces)


def decode_rgbd(pixels: NDArray[np.uint8]) -> Floats:
    """Linear colors (H, W, 3) of pixels (H, W, 4): alpha is what sRGB colors are divided by."""
    divisor = np.maximum(pixels[..., 3:].astype(np.float32), 1) / 255
    colors: Floats = LINEAR_OF_SRGB[pixels[..., :3]] / divisor
    return colors


def unroll_cube(faces: Floats) -> Floats:
    """The map (H, W, 3), by longitude and latitude, of a cube's faces (6, N, N, 3) at +x, -x, +y, -y, +z and -z.

    Seen from inside the cube the faces aren't mirrored, other than in graphics programming interfaces.
    """
    # Four faces are around the horizon.
    width = min(4 * faces.shape[1], LARGEST_MAP)
    toward = directions(max(width // 2, 1), width)
    # A direction meets the face of its largest component.
    axis = np.abs(toward).argmax(axis=-1)
    along = np.take_along_axis(toward, axis[..., None], -1)[..., 0]
    x, y, z = np.moveaxis(toward / np.abs(along)[..., None], -1, 0)
    sign = np.sign(along)
    across = np.select([axis == 0, axis == 1], [sign * z, -x], -sign * x)
    down = np.select([axis == 1], [sign * z], -y)
    # Positions in texels between the centers of the first and the last one.
    last = len(faces[0]) - 1
    column, row = (((at + 1) / 2 * len(faces[0]) - 0.5).clip(0, last) for at in (across, down))
    face = 2 * axis + np.where(sign < 0, 1, 0)
    # Bilinear interpolation. Texels beyond a face's edge are repeated, not those of the next face.
    left, top = np.floor(column).astype(int), np.floor(row).astype(int)
    right, bottom = np.minimum(left + 1, last), np.minimum(top + 1, last)
    share, rest = (column - left)[..., None], (row - top)[..., None]
    upper = faces[face, top, left] * (1 - share) + faces[face, top, right] * share
    lower = faces[face, bottom, left] * (1 - share) + faces[face, bottom, right] * share
    found: Floats = upper * (1 - rest) + lower * rest
    return found
