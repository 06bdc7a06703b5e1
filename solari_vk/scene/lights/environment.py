"""Environment maps: light from all directions at infinity, as a picture of them."""

from __future__ import annotations

import os
from dataclasses import KW_ONLY, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.base.color import LUMINANCE_WEIGHTS
from solari_vk.base.errors import warn
from solari_vk.scene import checks
from solari_vk.scene.checks import FloatArray
from solari_vk.scene.lights.light import Light
from solari_vk.scene.matrices import is_rotation, rotation
from solari_vk.scene.observable import checked

MOST_TEXELS = 2**23  # 4096 x 2048; larger pictures are averaged down


class EnvironmentLight(Light):
    """What lights a scene from infinity: an Environment or a Sky. `scene.environment` takes one."""

    image: FloatArray
    intensity: float
    rotation: FloatArray
    _known: tuple[FloatArray, float, NDArray[np.float64]] | None = None

    @property
    def lights(self) -> tuple[Light, ...]:
        """The lights that the scene gets."""
        return (self,)

    def turn(self, angle: float) -> None:
        """Turn the environment about the y axis by an angle in radians."""
        raise NotImplementedError

    @property
    def emits(self) -> bool:
        """Whether the environment emits anything."""
        return self.flux > 0

    @property
    def flux(self) -> float:
        """The integral of luminance over all directions, in lux."""
        return self.intensity * self._facts()[1]

    @property
    def brightest(self) -> NDArray[np.float64]:
        """The direction (3,) in the world of the texel that sends the most light."""
        # Maps have directions of their own; the rotation turns them into the world's.
        found: NDArray[np.float64] = self.rotation.astype(np.float64) @ self._facts()[2]
        return found

    def _facts(self) -> tuple[FloatArray, float, NDArray[np.float64]]:
        """The image, its flux and its brightest direction, computed once for each image."""
        # By identity: images are read-only, a change is another image.
        if self._known is None or self._known[0] is not self.image:
            size = self.image.shape[:2]
            light = luminances(self.image) * solid_angles(*size)
            row, column = np.unravel_index(np.argmax(light), size)
            object.__setattr__(self, "_known", (self.image, float(light.sum()), directions(*size)[row, column]))
        assert self._known is not None
        return self._known


def _image(value: Any) -> FloatArray:
    if isinstance(value, (str, os.PathLike)):
        from solari_vk.scene.images.radiance_files import read_radiance

        value = read_radiance(value)
    texels = np.asarray(value)
    if texels.ndim in (0, 1):  # one color in all directions
        texels = np.broadcast_to(texels, (1, 1, 3))
    elif texels.ndim == 2:
        texels = np.stack([texels] * 3, axis=-1)
    image: FloatArray = checks.array(None, None, 3, max_abs=checks.LARGEST_RADIANCE)(texels)
    if 0 in image.shape:
        raise ValueError("must have at least one pixel")
    if image.min() < 0:
        where = tuple(int(i) for i in np.argwhere(image < 0)[0])
        raise ValueError(f"must not be negative, but element {where} is {image[where]}")
    # Sampling needs tables of the map's size.
    while image.shape[0] * image.shape[1] > MOST_TEXELS:
        image = _halved(_halved(image, 0), 1)
        image.setflags(write=False)
    return image


def _halved(image: FloatArray, axis: int) -> FloatArray:
    """The mean of each two rows or columns; a single last one stays as it is."""
    if image.shape[axis] == 1:
        return image
    starts = np.arange(0, image.shape[axis], 2)
    counts = np.diff(np.append(starts, image.shape[axis])).astype(np.float32)
    # An odd size has a last row or column alone, so that no light is lost.
    sums = np.add.reduceat(image, starts, axis=axis)
    return (sums / counts.reshape(-1, *[1] * (2 - axis))).astype(np.float32)


def halved_to(image: FloatArray, rows: int) -> FloatArray:
    """The picture, averaged down by halves to this number of rows at most."""
    while len(image) > rows:
        image = _halved(_halved(image, 0), 1)
    return image


def _rotation(value: ArrayLike) -> FloatArray:
    """A rotation matrix (3, 3), from one or from an angle in radians about the y axis."""
    turn = np.asarray(value, np.float64)
    if turn.ndim == 0:
        checks.refuse_not_finite(turn[None])
        # A whole number so far beyond a turn was meant in degrees.
        if abs(float(turn)) >= 10 and float(turn).is_integer():
            warn("Environment: rotation is in radians: for 90 degrees give math.radians(90)")
        turn = rotation((0, 1, 0), float(turn))
    matrix: FloatArray = checks.array(3, 3)(turn)
    if not is_rotation(turn):
        raise ValueError("must be an angle in radians, or a rotation matrix (3, 3), which neither scales nor mirrors")
    return matrix


@checked
class Environment(EnvironmentLight):
    """Light from all directions at infinity, which cameras and mirrors see as the background.

    image: radiance in cd/m^2 as linear Rec. 709 colors (height, width, 3), by longitude and latitude: the first row is
    up, +y, and the middle column is +x, as in Blender and three.js. Any size and shape covers all directions. A number
    or a color (3,) is the same light from everywhere. A path names a file: .hdr (Radiance), .exr, or .png and .jpg,
    whose white is 1 cd/m^2. Pictures of more than 8 Mi pixels, 4096 x 2048, are averaged down.
    intensity: a factor of the radiance. rotation: an angle in radians about +y, or a rotation matrix (3, 3), which
    turns the picture in the world. Changes of both are as cheap as moving a light. Raises SolariError for negative and
    infinite values, and for files that can't be read.
    """

    image: Any
    _: KW_ONLY
    intensity: float = 1.0
    rotation: Any = field(default_factory=lambda: np.eye(3, dtype=np.float32))
    name: str = ""

    _converters = {"image": _image, "intensity": checks.number(0, 1e9), "rotation": _rotation, "name": checks.text}

    def turn(self, angle: float) -> None:
        """Turn the map about the y axis by an angle in radians."""
        self.rotation = rotation((0, 1, 0), angle) @ self.rotation


def luminances(image: FloatArray) -> NDArray[np.float64]:
    """The luminance (height, width) of an image."""
    found: NDArray[np.float64] = image.astype(np.float64) @ np.array(LUMINANCE_WEIGHTS)
    return found


def directions(height: int, width: int) -> NDArray[np.float64]:
    """The directions (height, width, 3) of the centers of a map's texels."""
    longitude = 2 * np.pi * ((np.arange(width) + 0.5) / width - 0.5)
    polar = (np.pi * (np.arange(height) + 0.5) / height)[:, None]
    sine = np.sin(polar)
    up = np.broadcast_to(np.cos(polar), (height, width))
    return np.stack([sine * np.cos(longitude), up, sine * np.sin(longitude)], axis=-1)


def solid_angles(height: int, width: int) -> NDArray[np.float64]:
    """The solid angles (height, 1) of the texels of each row; their sum over all texels is 4 pi."""
    # The area of a zone of the unit sphere is its height times the circle's length: Archimedes.
    edges = np.cos(np.pi * np.arange(height + 1) / height)
    return ((edges[:-1] - edges[1:]) * (2 * np.pi / width))[:, None]
