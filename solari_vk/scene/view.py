"""The camera as the shaders' uniforms hold it."""

from __future__ import annotations

import math
from operator import is_
from typing import Any, NamedTuple

import numpy as np

from solari_vk.gpu.frame.uniforms import Uniforms
from solari_vk.scene.model import Camera

Numbers = tuple[float, ...]


def _halton(index: int, base: int) -> float:
    """The radical inverse of a number: Halton (1964)."""
    result, part = 0.0, 1.0
    while index:
        part /= base
        result += part * (index % base)
        index //= base
    return result


# Where samples lie in a pixel, from its centre, in pixels; then the pattern begins anew.
JITTERS = [(_halton(index, 2) - 0.5, _halton(index, 3) - 0.5) for index in range(1, 33)]


class View(NamedTuple):
    """A camera over a picture, in plain numbers: the fields after `source` as the uniforms of their names."""

    source: tuple[Any, ...]  # what it was made from
    world_from_view: Numbers  # 12, four columns of a matrix that maps points
    tan_half_fov: tuple[float, float]
    near: float
    view_from_world: Numbers
    jitter: tuple[float, float]  # the camera's own
    exposure: float

    @classmethod
    def of(cls, camera: Camera, size: tuple[int, int], known: View | None = None) -> View:
        """The camera as it is now, over a picture of that size in pixels; `known` itself if nothing was assigned."""
        source = camera.transform, camera.jitter, camera.vertical_fov, camera.near, camera.ev100, size
        if known is not None and all(map(is_, source, known.source)):
            return known
        (a, b, c, x), (d, e, f, y), (g, h, i, z), _ = camera.transform.tolist()
        # Axes of length 1, or depths would be in the camera's own units.
        p, q, r = math.hypot(a, d, g), math.hypot(b, e, h), math.hypot(c, f, i)
        a, d, g, b, e, h, c, f, i = a / p, d / p, g / p, b / q, e / q, h / q, c / r, f / r, i / r
        # Rows of the inverse: each axis's is the other two's cross product, over the volume of all.
        volume = a * (e * i - h * f) + d * (h * c - b * i) + g * (b * f - e * c)
        j, k, m = (e * i - h * f) / volume, (h * c - b * i) / volume, (b * f - e * c) / volume
        n, o, p = (f * g - i * d) / volume, (i * a - c * g) / volume, (c * d - f * a) / volume
        q, r, s = (d * h - g * e) / volume, (g * b - a * h) / volume, (a * e - d * b) / volume
        tan_half_fov = math.tan(camera.vertical_fov / 2)
        jitter_x, jitter_y = camera.jitter.tolist()
        return cls(
            source,
            (a, d, g, b, e, h, c, f, i, x, y, z),
            (tan_half_fov * size[0] / size[1], tan_half_fov),
            camera.near,
            (j, n, q, k, o, r, m, p, s,
             -j * x - k * y - m * z, -n * x - o * y - p * z, -q * x - r * y - s * z),
            (jitter_x, jitter_y),
            camera.exposure,
        )  # fmt: skip


def write_view(uniforms: Uniforms, camera: Camera, size: tuple[int, int], rows: int) -> None:
    """What every pass that starts at pixels needs: the camera, the picture's size, and the rows of a dispatch."""
    view = View.of(camera, size)
    uniforms["world_from_view"] = np.reshape(view.world_from_view, (4, 3))
    uniforms["view_from_world"] = np.reshape(view.view_from_world, (4, 3))
    uniforms["tan_half_fov"], uniforms["near"] = view.tan_half_fov, view.near
    uniforms["size"] = size
    uniforms["jitter"] = camera.jitter
    uniforms["row_count"] = rows
