"""Environment maps in double precision: their radiance in a direction, and the irradiance of a surface."""

import numpy as np


def radiance(environment, directions):
    """The radiance (N, 3) from directions (N, 3), interpolated between the centers of the image's pixels."""
    image = environment.image.astype(np.float64) * environment.intensity
    height, width = image.shape[:2]
    x, y, z = (np.asarray(directions, np.float64) @ environment.rotation.astype(np.float64)).T
    column = width * (np.arctan2(z, x) / (2 * np.pi) + 0.5) - 0.5
    row = height * np.arctan2(np.hypot(x, z), y) / np.pi - 0.5
    left, top = np.floor(column).astype(int), np.floor(row).astype(int)
    right_share, bottom_share = (column - left)[:, None], (row - top)[:, None]

    def at(rows, columns):
        return image[rows.clip(0, height - 1), columns % width]

    upper = at(top, left) * (1 - right_share) + at(top, left + 1) * right_share
    lower = at(top + 1, left) * (1 - right_share) + at(top + 1, left + 1) * right_share
    return upper * (1 - bottom_share) + lower * bottom_share


def irradiance(environment, normal, rows=512):
    """The irradiance (3,) of a surface with this unit normal (3,): a sum over a grid of directions around it."""
    z = np.asarray(normal, np.float64)
    x = np.cross(z, (0.0, 0.0, 1.0) if abs(z[2]) < 0.9 else (1.0, 0.0, 0.0))
    x /= np.linalg.norm(x)
    # The square of the sine is even over cosine-weighted directions.
    share = np.repeat((np.arange(rows) + 0.5) / rows, 2 * rows)
    turn = np.tile(2 * np.pi * (np.arange(2 * rows) + 0.5) / (2 * rows), rows)
    sine = np.sqrt(share)
    local = np.stack([sine * np.cos(turn), sine * np.sin(turn), np.sqrt(1 - share)], axis=-1)
    return np.pi * radiance(environment, local @ np.stack([x, np.cross(z, x), z])).mean(axis=0)
