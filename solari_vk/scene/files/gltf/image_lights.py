"""The environment of a glTF file: EXT_lights_image_based."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene.files.gltf.document import Document
from solari_vk.scene.files.gltf.images import Images
from solari_vk.scene.files.gltf.report import Report
from solari_vk.scene.files.gltf.values import Entry, shown, whole
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
    levels = light.values("specularImages", "a list of levels of six images", lambda level: isinstance(level, list))
    numbers = [face for value in (levels or [[]])[0] if (face := whole(value)) is not None and face >= 0]
    if len(numbers) != _FACES or len(levels[0]) != _FACES:
        raise light.wrong("specularImages", "a list of levels of six images")
    images = Images(document, report, strict)
    images.read({(face,): light for face in numbers})
    found = [image.pixels for face in numbers if (image := images[(face,)]) is not None]
    if len(found) < _FACES or any(pixels.shape != (len(found[0]), len(found[0]), 4) for pixels in found):
        report.add("environments whose images can't be read or aren't equal squares are left out", light.place)
        return None
    faces = np.stack([decode_rgbd(pixels) for pixels in found])
    x, y, z, w = light.numbers("rotation", (0.0, 0.0, 0.0, 1.0), low=-1e6, high=1e6)
    turn = np.array(quaternion_rotation(x, y, z, w))
    return Environment(
        unroll_cube(faces),
        intensity=light.number("intensity", 1.0, low=0, high=1e9),
        rotation=nearest_rotation(turn) if turn.any() else np.eye(3),
        name=light.name,
    )


def decode_rgbd(pixels: NDArray[np.uint8]) -> Floats:
    """Linear colors (H, W, 3) of pixels (H, W, 4): alpha is what sRGB colors are divided by."""
    divisor = np.maximum(pixels[..., 3:].astype(np.float32), 1) / 255
    colors: Floats = LINEAR_OF_SRGB[pixels[..., :3]] / divisor
    return colors


def unroll_cube(faces: Floats) -> Floats:
    """The map (H, W, 3), by longitude and latitude, of a cube's faces (6, N, N, 3) at +x, -x, +y, -y, +z and -z.

    Seen from inside the cube the faces aren't mirrored, other than in graphics programming interfaces.
    """
    width = min(4 * faces.shape[1], LARGEST_MAP)
    toward = directions(max(width // 2, 1), width)
    axis = np.abs(toward).argmax(axis=-1)
    along = np.take_along_axis(toward, axis[..., None], -1)[..., 0]
    x, y, z = np.moveaxis(toward / np.abs(along)[..., None], -1, 0)
    sign = np.sign(along)
    across = np.select([axis == 0, axis == 1], [sign * z, -x], -sign * x)
    down = np.select([axis == 1], [sign * z], -y)
    # Positions in texels between the centers of the first and the last one.
    column, row = (((at + 1) / 2 * len(faces[0]) - 0.5).clip(0, len(faces[0]) - 1) for at in (across, down))
    face = 2 * axis + (sign < 0)
    left, top = np.floor(column).astype(int), np.floor(row).astype(int)
    right, bottom = (np.minimum(at + 1, len(faces[0]) - 1) for at in (left, top))
    share, rest = (column - left)[..., None], (row - top)[..., None]
    upper = faces[face, top, left] * (1 - share) + faces[face, top, right] * share
    lower = faces[face, bottom, left] * (1 - share) + faces[face, bottom, right] * share
    found: Floats = upper * (1 - rest) + lower * rest
    return found
