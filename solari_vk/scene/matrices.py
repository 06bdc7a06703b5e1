"""Vectors, rotations and affine matrices: numpy holds matrices by rows (for column vectors), GLSL by columns."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.base.errors import SolariError, checked_keywords, quoted

_ROTATION_ERROR = 1e-3


def unit(vectors: ArrayLike) -> NDArray[np.float64]:
    """Vectors (..., N) with their lengths made 1. Zero vectors, and those with an infinity or a NaN, become zero."""
    values = np.asarray(vectors, np.float64)
    largest = np.abs(values).max(axis=-1, keepdims=True)
    fits = (largest > 0) & np.isfinite(largest)
    scaled = np.where(fits, values, 0) / np.where(fits, largest, 1)  # else the squares could overflow
    lengths = np.linalg.norm(scaled, axis=-1, keepdims=True)
    found: NDArray[np.float64] = scaled / np.where(fits, lengths, 1)
    return found


def orthogonal(normals: NDArray[Any]) -> NDArray[np.float64]:
    """A unit vector orthogonal to each of the normals (N, 3)."""
    # The axis that is farthest from the normal, so that the cross product keeps its digits.
    least_aligned = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    return unit(np.cross(least_aligned, normals))


def rotation(axis: ArrayLike, angle: float) -> NDArray[np.float64]:
    """The matrix (3, 3) of a rotation by an angle in radians about an axis (3,) of any length."""
    x, y, z = math.sin(angle / 2) * unit(axis)
    return np.array(quaternion_rotation(x, y, z, math.cos(angle / 2)))


def quaternion_rotation(x: Any, y: Any, z: Any, w: Any) -> list[list[Any]]:
    """The rows of the rotation matrix of a unit quaternion. Each component is one number, or an array of many.

    A zero quaternion gives zeros.
    """
    return [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]


@checked_keywords(who="solari_vk")
def euler(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> NDArray[np.float64]:
    """The unit quaternion (x, y, z, w) of three angles in degrees, for `rotation` of instances, cameras and groups.

    It turns about the x axis first, then about y, then about z, each counter-clockwise seen from the axis's end, and
    the axes stay those of the world: what Blender calls an XYZ Euler, and three.js the order "ZYX". Raises SolariError
    for angles that aren't finite numbers.
    """
    try:
        halves = [math.radians(float(angle)) / 2 for angle in (x, y, z)]
        # The product of three quaternions, each of which turns about one axis.
        (a, b, c), (i, j, k) = map(math.cos, halves), map(math.sin, halves)
        if math.isnan(a + b + c):
            raise ValueError
    except (TypeError, ValueError, OverflowError):
        raise SolariError(
            f"euler: takes three angles in degrees, such as euler(0, 90, 0), not {quoted((x, y, z))}"
        ) from None
    return np.array((i * b * c - a * j * k, a * j * c + i * b * k, a * b * k - i * j * c, a * b * c + i * j * k))


_THICKNESS = 1e-4  # of what a matrix flattens, over the size of what is left


@np.errstate(over="ignore", invalid="ignore")
def thickened(matrices: NDArray[Any]) -> NDArray[np.float64]:
    """Matrices (..., 4, 4), of which those that flatten all things to a plane leave them a thickness of a
    ten-thousandth, so that they have an inverse and don't mirror. Those that leave a line or a point stay."""
    found = np.array(matrices, np.float64)
    x, y, z = np.moveaxis(found[..., :3, :3], -1, 0)
    # The matrix of cofactors of a matrix of rank 2 is the product of the two directions that the matrix loses, one of
    # each space, and of the area that is left of a unit square.
    cofactors = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], axis=-1)
    lengths = np.linalg.norm(found[..., :3, :3], axis=-2).prod(axis=-1)
    is_flat = np.abs((x * cofactors[..., 0]).sum(axis=-1)) <= 1e-9 * lengths
    area = np.linalg.norm(cofactors, axis=(-2, -1))
    is_plane = is_flat & (area > 0)
    factor = np.zeros(area.shape)
    factor[is_plane] = _THICKNESS / np.sqrt(area[is_plane])
    found[..., :3, :3] += factor[..., None, None] * cofactors
    return found


def compose(translations: NDArray[Any], rotations: NDArray[Any], scales: NDArray[Any]) -> NDArray[np.float64]:
    """Matrices (N, 4, 4) from translations (N, 3), quaternions (N, 4: x y z w) and scales (N, 3).

    A quaternion of zero length is no rotation.
    """
    length = np.linalg.norm(rotations, axis=1, keepdims=True)
    x, y, z, w = np.where(length > 0, rotations / np.where(length > 0, length, 1), (0, 0, 0, 1)).T
    matrices = np.zeros((len(translations), 4, 4))
    matrices[:, :3, :3] = np.array(quaternion_rotation(x, y, z, w)).transpose(2, 0, 1) * scales[:, None, :]
    matrices[:, :3, 3] = translations
    matrices[:, 3, 3] = 1
    return matrices


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def upright(world: NDArray[Any]) -> NDArray[np.float64] | None:
    """The matrix without scale and shear, with the same view along -z and the same up; None if that is degenerate."""
    world = thickened(world)
    # z and y are kept in this order: the view matters more than where up is.
    back = world[:3, 2] / np.linalg.norm(world[:3, 2])
    right = np.cross(world[:3, 1], back)
    right /= np.linalg.norm(right)
    result = np.eye(4)
    result[:3, :3] = np.stack([right, np.cross(back, right), back], axis=1)
    result[:3, 3] = world[:3, 3]
    return result if np.isfinite(result).all() else None


def is_rotation(matrix: NDArray[Any]) -> bool:
    """Whether a matrix (3, 3) neither scales, shears nor mirrors, up to the rounding of files and of 32 bits."""
    error = np.abs(matrix @ matrix.T - np.eye(3)).max()
    return bool(error <= _ROTATION_ERROR and np.linalg.det(matrix) > 0)


def nearest_rotation(matrix: NDArray[Any]) -> NDArray[np.float64]:
    """The rotation (3, 3) nearest to a matrix that doesn't mirror."""
    # The polar decomposition: the rotation part is nearest in the Frobenius norm (Higham, 1986).
    left, _, right = np.linalg.svd(matrix)
    found: NDArray[np.float64] = left @ right
    return found


def turned_about(center: ArrayLike, turn: NDArray[Any], transform: NDArray[Any]) -> NDArray[np.float64]:
    """A transform (4, 4) after a rotation (3, 3) about a center (3,)."""
    pivot = np.asarray(center, np.float64)
    result = np.array(transform, np.float64)
    result[:3, :3] = turn @ transform[:3, :3]
    result[:3, 3] = pivot + turn @ (transform[:3, 3] - pivot)
    return result


def transform_points(matrix: NDArray[Any], points: NDArray[Any]) -> NDArray[Any]:
    """Points (..., 3) moved by a 3x4 or 4x4 matrix."""
    moved: NDArray[Any] = transform_directions(matrix, points) + matrix[:3, 3]
    return moved


def transform_directions(matrix: NDArray[Any], directions: NDArray[Any]) -> NDArray[Any]:
    """Directions (..., 3) turned and scaled by a matrix, without its translation."""
    turned: NDArray[Any] = directions @ matrix[:3, :3].T
    return turned


def by_columns(matrices: NDArray[Any]) -> NDArray[Any]:
    """Matrices (..., rows, columns) of numpy in the order of a GLSL matrix (..., columns, rows), or back."""
    return np.swapaxes(matrices, -1, -2)


def placed_box(
    transform: NDArray[Any], center: NDArray[Any], half_size: NDArray[Any]
) -> tuple[tuple[float, float, float], tuple[float, float, float], float]:
    """The center and half size of the bounds of a box that a matrix (4, 4) moves, and the factor by which its volume
    grows. In plain numbers, which is fastest for one box."""
    (a, b, c, x), (d, e, f, y), (g, h, i, z), _ = transform.tolist()
    p, q, r = center.tolist()
    # Arvo, "Transforming Axis-Aligned Bounding Boxes" (Graphics Gems, 1990).
    place = a * p + b * q + c * r + x, d * p + e * q + f * r + y, g * p + h * q + i * r + z
    p, q, r = half_size.tolist()
    half = (
        abs(a * p) + abs(b * q) + abs(c * r),
        abs(d * p) + abs(e * q) + abs(f * r),
        abs(g * p) + abs(h * q) + abs(i * r),
    )
    return place, half, abs(a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g))
