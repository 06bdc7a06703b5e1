"""Affine matrices: numpy holds them by rows (3x4 or 4x4, for column vectors), GLSL by columns."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


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
