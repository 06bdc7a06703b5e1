"""Shapes for tests of acceleration structures."""

import numpy as np

CENTER = np.array([0.6, 0.3, 5.0])
"""A point at distance 5 above the first triangle of `quad()`."""
DOWN = np.array([0.0, 0.0, -1.0])


def quad(x=0.0, y=0.0, z=0.0):
    """Two triangles without indices, facing +z, of the unit square at (x, y, z)."""
    a, b, c, d = ((x, y, z), (x + 1, y, z), (x + 1, y + 1, z), (x, y + 1, z))
    return np.array([a, b, c, a, c, d], np.float32)


def shifted(x=0.0, y=0.0, z=0.0):
    """A translation (3, 4)."""
    return np.array([[1, 0, 0, x], [0, 1, 0, y], [0, 0, 1, z]], np.float32)
