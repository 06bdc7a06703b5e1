"""What lenses do to a picture beside its projection: vignetting and lateral chromatic aberration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, quoted
from solari_vk.scene import checks
from solari_vk.scene.model import Camera

Floats = NDArray[np.float64]


def principal_point(camera: Camera | None, width: int, height: int) -> Floats:
    """Where the view axis is in a picture, (2,) in pixels; the middle without a camera."""
    share = np.full(2, 0.5) if camera is None else camera.principal_point
    return share * (width, height) - 0.5


def relative_illumination(
    vignetting: str | Sequence[float], camera: Camera | None, center: Floats, shape: tuple[int, int]
) -> Floats:
    """The share of light (height, width) that reaches each pixel; the arguments are those of `Sensor`."""
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    if not isinstance(vignetting, str):
        squared = ((columns - center[0]) ** 2 + (rows - center[1]) ** 2) / ((shape[0] ** 2 + shape[1] ** 2) / 4)
        try:
            terms = checks.array(None, dtype=np.float64)(vignetting)
        except (TypeError, ValueError, OverflowError) as error:
            raise SolariError(f"Sensor: vignetting {error}") from None
        share: Floats = np.polynomial.polynomial.polyval(squared, [1.0, *terms.tolist()])
        if not (share >= 0).all():
            raise SolariError(
                f"Sensor: the vignetting {quoted(list(vignetting))} is negative in a picture of {shape[1]}x{shape[0]}"
            )
        return share
    if vignetting == "none":
        return np.ones(shape)
    if camera is None or camera.projection != "perspective" or camera.orthographic_height:
        raise SolariError('Sensor: vignetting "cos4" needs a perspective camera: give expose(radiance, camera)')
    _, along = camera.rays(np.stack([columns, rows], -1), (shape[1], shape[0]))
    axis = -camera.transform[:3, 2] / np.linalg.norm(camera.transform[:3, 2])
    return np.asarray((along @ axis) ** 4, np.float64)


def magnify_colors(light: Floats, center: Floats, magnification: tuple[float, float]) -> Floats:
    """A picture whose red and blue are magnified about a point by 1 plus these, by bilinear interpolation."""
    found = light.copy()
    rows, columns = np.mgrid[: light.shape[0], : light.shape[1]].astype(np.float64)
    for color, more in ((0, magnification[0]), (2, magnification[1])):
        x, y = ((at - middle) / (1 + more) + middle for at, middle in ((columns, center[0]), (rows, center[1])))
        found[..., color] = _sample(light[..., color], x, y)
    return found


def _sample(values: Floats, x: Floats, y: Floats) -> Floats:
    """Values at places, bilinearly; beyond the edges those of the edge."""
    height, width = values.shape
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    left, top = np.minimum(x.astype(int), max(width - 2, 0)), np.minimum(y.astype(int), max(height - 2, 0))
    right, below = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    u, v = x - left, y - top
    upper = values[top, left] * (1 - u) + values[top, right] * u
    lower = values[below, left] * (1 - u) + values[below, right] * u
    return np.asarray(upper * (1 - v) + lower * v, np.float64)
