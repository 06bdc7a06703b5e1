"""How a camera reaches the shaders: Camera -> Projection -> the uniform blocks `camera` and `previous_camera`.

glsl/scene/camera_block.glsl declares the blocks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import is_
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from solari_vk.gpu.frame.uniforms import Uniforms
from solari_vk.scene.calibrated import LENS_FIELDS, lens_of
from solari_vk.scene.model import Camera
from solari_vk.scene.quasirandom import PLASTIC_STEPS, additive, radical_inverse

Numbers = tuple[float, ...]
# Of struct Camera.
FIELDS = (
    "world_from_view",
    "view_from_world",
    "tan_half_fov",
    "near",
    "orthographic_range",
    "lens_radius",
    "focus_distance",
    "aperture_blades",
    "aperture_rotation",
    "size",
    "picture_size",
    "jitter",
    "principal_shift",
    "lens_offset",
    "lens",
)
# How far raster sees in parallel projections, in heights of the picture: further away depths would be too coarse.
ORTHOGRAPHIC_RANGE = 4096.0


def jitters(count: int) -> list[tuple[float, float]]:
    """Sample positions in `count` successive frames, relative to the pixel's center, in pixels."""
    # Halton's sequence, without its first point, which lies in a corner.
    return [(radical_inverse(index, 2) - 0.5, radical_inverse(index, 3) - 0.5) for index in range(1, count + 1)]


def lens_point(camera: Camera, number: int) -> tuple[float, float]:
    """A point of a camera's lens in meters from its middle, (0, 0) without an aperture: those of successive numbers
    cover it evenly; the same points of disks and polygons as sample_aperture of glsl/scene/camera.glsl."""
    if not camera.aperture:
        return 0.0, 0.0
    u, v = (additive(number, step) for step in PLASTIC_STEPS)
    blades = camera.aperture_blades
    radius = camera.aperture / 2
    if not blades:
        # A disk: the square root of a uniform number is the radius of a point that is uniform in area.
        return radius * math.sqrt(u) * math.cos(2 * math.pi * v), radius * math.sqrt(u) * math.sin(2 * math.pi * v)
    # A regular polygon: a triangle between the middle and two corners, and a point of the triangle, uniform in area.
    blade = int(u * blades)
    root = math.sqrt(u * blades % 1)
    first, second = (2 * math.pi * (blade + more) / blades + camera.aperture_rotation for more in (0, 1))
    return (
        radius * root * ((1 - v) * math.cos(first) + v * math.cos(second)),
        radius * root * ((1 - v) * math.sin(first) + v * math.sin(second)),
    )


# Between the numbers of the points of the lens, and of times of an exposure, of frames with successive seeds: a prime,
# so that frames of different seeds seldom have the same numbers.
SEED_STRIDE = 7919
# The sample positions of pictures that aren't upscaled. The sequence repeats.
JITTERS = jitters(32)


# Where the numbers of a projection have the camera's position, and the columns of view_from_world.
_POSITION = 9
_INVERSE = 12


class Projection(NamedTuple):
    """A camera over a picture of some size, in plain numbers."""

    source: tuple[Any, ...]
    """What the projection was made from."""
    numbers: Numbers
    """The fields of the shaders' struct Camera in its order, but for sizes, offsets and lens."""
    jitter: tuple[float, float]
    """The camera's own, in pixels."""
    principal_shift: tuple[float, float]
    """From the principal point to the middle of the picture, in pixels."""
    lens: Numbers
    """The fields of the shaders' struct Lens."""
    exposure: float

    @property
    def view(self) -> tuple[Any, ...]:
        """All that decides on what each pixel shows."""
        return self.numbers, self.jitter, self.principal_shift, self.lens

    def numbers_from(self, origin: Sequence[float]) -> Numbers:
        """`numbers` in coordinates that count from an origin (3,): the scene's."""
        if not any(origin):
            return self.numbers
        numbers = self.numbers
        x, y, z = (numbers[_POSITION + axis] - origin[axis] for axis in range(3))
        rows = (numbers[_INVERSE + axis : _INVERSE + 9 : 3] for axis in range(3))
        moved = (-a * x - b * y - c * z for a, b, c in rows)
        return (*numbers[:_POSITION], x, y, z, *numbers[_INVERSE : _INVERSE + 9], *moved, *numbers[_INVERSE + 12 :])

    @classmethod
    def of(cls, camera: Camera, size: tuple[int, int], known: Projection | None = None) -> Projection:
        """The projection of a camera as it is now; `known` itself if nothing was assigned to the camera since then."""
        source = (
            camera.transform,
            camera.jitter,
            camera.vertical_fov,
            camera.near,
            camera.ev100,
            camera.orthographic_height,
            camera.aperture,
            camera.focus_distance,
            camera.aperture_blades,
            camera.aperture_rotation,
            size,
            *(getattr(camera, name) for name in LENS_FIELDS),
        )
        if known is not None and all(map(is_, source, known.source)):
            return known
        height = camera.orthographic_height
        lens = lens_of(camera, size)
        jitter_x, jitter_y = camera.jitter.tolist()
        center_x, center_y = camera.principal_point.tolist()
        shift = (0.5 - center_x) * size[0], (0.5 - center_y) * size[1]
        numbers = (
            *_matrices(camera),
            *lens.half,
            camera.near,
            ORTHOGRAPHIC_RANGE * height,
            camera.aperture / 2,
            camera.focus_distance,
            camera.aperture_blades,
            camera.aperture_rotation,
        )
        found = lens.kind, lens.limit, lens.reach, *lens.distortion
        return cls(source, numbers, (jitter_x, jitter_y), shift, found, camera.exposure)


def _matrices(camera: Camera) -> Numbers:
    """world_from_view, then view_from_world, (24,) column by column, as matrices of GLSL lie in memory."""
    (a, b, c, x), (d, e, f, y), (g, h, i, z), _ = camera.transform.tolist()
    # Axes of length 1, or depths would be in the camera's own units.
    right = _unit(a, d, g)
    up = _unit(b, e, h)
    back = _unit(c, f, i)
    # A row of the inverse is the cross product of the other two axes, over the volume of all three.
    row = _cross(up, back)
    volume = right[0] * row[0] + right[1] * row[1] + right[2] * row[2]
    j, k, m = (number / volume for number in row)
    n, o, p = (number / volume for number in _cross(back, right))
    q, r, s = (number / volume for number in _cross(right, up))
    # The inverse moves the camera's position to 0.
    moved = (-j * x - k * y - m * z, -n * x - o * y - p * z, -q * x - r * y - s * z)
    return (*right, *up, *back, *(x, y, z), *(j, n, q), *(k, o, r), *(m, p, s), *moved)


def _unit(x: float, y: float, z: float) -> tuple[float, float, float]:
    length = math.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length


def _cross(a: tuple[float, float, float], b: tuple[float, float, float]) -> tuple[float, float, float]:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


class CameraUniforms:
    """Writes a camera to the uniform blocks of a frame's shaders, frame by frame. origin: the scene's, (3,)."""

    def __init__(self, uniforms: Uniforms, origin: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        self._origin: list[float] = np.asarray(origin, np.float64).tolist()
        self._current = uniforms.writer("camera", FIELDS)
        self._previous = uniforms.writer("previous_camera", FIELDS)
        self._projection: Projection | None = None
        self._latest: Numbers = ()  # what `camera` has, for `previous_camera` of the next frame

    def write(
        self,
        camera: Camera,
        size: tuple[int, int],
        offset: tuple[float, float] = (0.0, 0.0),
        *,
        render_size: tuple[int, int] | None = None,
        has_history: bool = False,
        lens_offset: tuple[float, float] = (0.0, 0.0),
    ) -> Projection:
        """Write the camera to the block `camera`. The block `previous_camera` gets the camera of the call before if
        there is a history, and else the same camera.

        size: of the picture in pixels. render_size: of what is rendered, by default the same. offset: added to the
        camera's jitter, in pixels of what is rendered. lens_offset: the point of the lens through which all is seen, in
        meters from its middle.
        """
        self._projection = Projection.of(camera, size, self._projection)
        self.write_projection(
            self._projection, size, offset, render_size=render_size, has_history=has_history, lens_offset=lens_offset
        )
        return self._projection

    def write_projection(
        self,
        projection: Projection,
        size: tuple[int, int],
        offset: tuple[float, float] = (0.0, 0.0),
        *,
        render_size: tuple[int, int] | None = None,
        has_history: bool = False,
        lens_offset: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """As `write`, for a camera's projection over a picture of this size."""
        width, height = render_size or size
        across, down = width / size[0], height / size[1]
        shift = projection.principal_shift[0] * across, projection.principal_shift[1] * down
        jitter = (
            projection.jitter[0] * across + offset[0] + shift[0],
            projection.jitter[1] * down + offset[1] + shift[1],
        )
        placed = projection.numbers_from(self._origin)
        numbers = (*placed, width, height, *size, *jitter, *shift, *lens_offset, *projection.lens)
        self._current.write(*numbers)
        self._previous.write(*(self._latest if has_history else numbers))
        self._latest = numbers
