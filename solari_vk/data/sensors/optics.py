"""What light passes on its way to a pixel: vignetting, lateral chromatic aberration, color filters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, quoted
from solari_vk.scene import checks
from solari_vk.scene.model import Camera

Floats = NDArray[np.float64]
BAYER_PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")


def principal_point(camera: Camera | None, width: int, height: int) -> Floats:
    """Where the view axis is in a picture, (2,) in pixels; the middle without a camera."""
    share = np.full(2, 0.5) if camera is None else camera.principal_point
    return share * (width, height) - 0.5


def relative_illumination(
    vignetting: str | Sequence[float], camera: Camera | None, center: Floats, shape: tuple[int, int]
) -> Floats:
    """The share of light (height, width) that reaches each pixel; the arguments are those of `Sensor`."""
    if not isinstance(vignetting, str):
        return _polynomial_vignetting(vignetting, center, shape)
    if vignetting == "none":
        return np.ones(shape)
    if camera is None or camera.projection != "perspective" or camera.orthographic_height:
        raise SolariError('Sensor: vignetting "cos4" needs a perspective camera: give expose(radiance, camera)')
    # A lens passes light by the fourth power of the cosine to its axis: the aperture is seen foreshortened, the pixel
    # is met at a slant, and it is farther away by 1 / cosine, squared.
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    _, along = camera.rays(np.stack([columns, rows], -1), (shape[1], shape[0]))
    axis = -camera.transform[:3, 2] / np.linalg.norm(camera.transform[:3, 2])
    return np.asarray((along @ axis) ** 4, np.float64)


def _polynomial_vignetting(coefficients: Sequence[float], center: Floats, shape: tuple[int, int]) -> Floats:
    """1 + a1 r^2 + a2 r^4 + ..., where r is 1 at half the picture's diagonal (Goldman 2010)."""
    try:
        terms = checks.array(None, dtype=np.float64)(coefficients)
    except (TypeError, ValueError, OverflowError) as error:
        raise SolariError(f"Sensor: vignetting {error}") from None
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    squared = ((columns - center[0]) ** 2 + (rows - center[1]) ** 2) / ((shape[0] ** 2 + shape[1] ** 2) / 4)
    share: Floats = np.polynomial.polynomial.polyval(squared, [1.0, *terms.tolist()])
    if not (share >= 0).all():
        raise SolariError(
            f"Sensor: the vignetting {quoted(list(coefficients))} is negative in a picture of {shape[1]}x{shape[0]}"
        )
    return share


def magnify_colors(light: Floats, center: Floats, magnification: tuple[float, float]) -> Floats:
    """A picture whose red and blue are magnified about a point by 1 plus these, by bilinear interpolation."""
    found = light.copy()
    rows, columns = np.mgrid[: light.shape[0], : light.shape[1]].astype(np.float64)
    # Green is the reference and stays as it is. A picture that is larger by a factor has at each place what the
    # original has nearer to the center by it.
    for color, more in ((0, magnification[0]), (2, magnification[1])):
        x = (columns - center[0]) / (1 + more) + center[0]
        y = (rows - center[1]) / (1 + more) + center[1]
        found[..., color] = _sample(light[..., color], x, y)
    return found


def _sample(values: Floats, x: Floats, y: Floats) -> Floats:
    """Values at places, bilinearly; beyond the edges those of the edge."""
    height, width = values.shape
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    # The last column and row are right and below of their neighbors, so that both neighbors exist.
    left, top = np.minimum(x.astype(int), max(width - 2, 0)), np.minimum(y.astype(int), max(height - 2, 0))
    right, below = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    u, v = x - left, y - top
    upper = values[top, left] * (1 - u) + values[top, right] * u
    lower = values[below, left] * (1 - u) + values[below, right] * u
    return np.asarray(upper * (1 - v) + lower * v, np.float64)


# ---- color filter arrays: Bayer, US patent 3,971,065 (1976) -----------------------------------------


def bayer_colors(pattern: str, shape: tuple[int, int]) -> NDArray[np.int64]:
    """The color of each pixel, (height, width): 0, 1, 2 for red, green, blue."""
    # Blocks of 2x2 pixels repeat; a picture of odd size ends within one.
    block = np.array(["RGB".index(letter) for letter in pattern]).reshape(2, 2)
    return np.tile(block, (-(-shape[0] // 2), -(-shape[1] // 2)))[: shape[0], : shape[1]]


def demosaic(values: Floats, colors: NDArray[np.int64]) -> Floats:
    """All three colors (height, width, 3) of pixels that have one each, by bilinear interpolation."""
    found = np.empty((*values.shape, 3))
    for color in range(3):
        # Bilinear interpolation as a normalized convolution: a weighted sum of neighbors that have the color, over the
        # sum of their weights.
        has_color = colors == color
        weights = _spread(has_color.astype(np.float64))
        found[..., color] = np.where(has_color, values, _spread(np.where(has_color, values, 0.0)) / weights)
    return found


def _spread(values: Floats) -> Floats:
    """Each value plus half of its neighbors and a quarter of those across corners."""
    rows = np.pad(values, ((1, 1), (0, 0)))
    rows = rows[1:-1] + (rows[:-2] + rows[2:]) / 2
    columns = np.pad(rows, ((0, 0), (1, 1)))
    found: Floats = columns[:, 1:-1] + (columns[:, :-2] + columns[:, 2:]) / 2
    return found
