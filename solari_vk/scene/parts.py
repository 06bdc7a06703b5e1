"""What built-in scenes are made of: colors, plain materials, and places."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.scene.checks import FloatArray
from solari_vk.scene.matrices import rotation
from solari_vk.scene.model import Material


def rgb(value: ArrayLike) -> FloatArray:
    """One number or three as a color (3,)."""
    return np.broadcast_to(np.asarray(value, np.float32), (3,))


def matte(color: ArrayLike, name: str = "", **fields: Any) -> Material:
    """A nearly Lambertian material: rough, with F0 = 0. A faint sheen remains at grazing angles."""
    return Material(base_color=rgb(color), perceptual_roughness=1.0, reflectance=rgb(0), name=name, **fields)


def lamp(radiance: ArrayLike, name: str = "lamp", **fields: Any) -> Material:
    """A material that emits light and reflects almost none."""
    return matte(0.0, name, emissive=rgb(radiance), **fields)


def place(scale: ArrayLike = 1.0, at: ArrayLike = (0, 0, 0), turn: float = 0.0) -> NDArray[np.float64]:
    """The matrix (4, 4) that scales, then turns about y by `turn` radians, then moves to `at` in meters."""
    transform = np.eye(4)
    transform[:3, :3] = rotation((0, 1, 0), turn) @ np.diag(np.broadcast_to(np.asarray(scale, np.float64), (3,)))
    transform[:3, 3] = at
    return transform
