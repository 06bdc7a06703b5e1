"""Path-traced pictures with measured variances, and how far they are from what they must be."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.conformance.rules import Measurement, Rule
from solari_vk.gpu.device.device import Device
from solari_vk.reference import PathTracer
from solari_vk.scene.model import Camera, Scene

_ALPHA = 0.005  # of all tiles of a picture together


@dataclass
class Picture:
    """Independent parts of one picture's samples, runs (R, h, w, 3): their mean, and the variance of that mean."""

    runs: NDArray[Any]

    @property
    def mean(self) -> NDArray[Any]:
        """(h, w, 3) in float64."""
        return self.runs.mean(axis=0, dtype=np.float64)  # type: ignore[no-any-return]

    @property
    def variance(self) -> NDArray[Any]:
        """(h, w, 3): of the mean."""
        return self.runs.var(axis=0, ddof=1, dtype=np.float64) / len(self.runs)  # type: ignore[no-any-return]


def take_picture(
    device: Device, scene: Scene, size: tuple[int, int] = (48, 48), samples: int = 64, *,
    runs: int = 8, camera: Camera | None = None, **settings: Any,
) -> Picture:  # fmt: skip
    """A picture of `samples` a pixel, in all; settings are PathTracer's.

    The variance comes from the spread of consecutive parts of the samples, not from the renderer's own estimate.
    """
    renderer = PathTracer(device, scene, size, **settings)
    try:
        view = camera or scene.camera
        part = max(samples // runs, 1)
        sums = [np.zeros((size[1], size[0], 3))]
        for run in range(1, runs + 1):
            image = renderer.render(view, samples=run * part)
            assert image.shape == sums[0].shape
            assert image.dtype == np.float32
            assert np.isfinite(image).all()
            sums.append(image * np.float64(run * part))
        return Picture(np.diff(np.stack(sums), axis=0) / part)
    finally:
        renderer.close()


def tile_means(image: NDArray[Any], size: int) -> NDArray[Any]:
    """Means (rows, columns, ...) of size x size tiles; the picture's edges that fill no tile are left out."""
    rows, columns = image.shape[0] // size, image.shape[1] // size
    cut = np.asarray(image, np.float64)[: rows * size, : columns * size]
    means: NDArray[Any] = cut.reshape(rows, size, columns, size, *image.shape[2:]).mean(axis=(1, 3))
    return means


def compare_picture(
    name: str, source: tuple[str, str], made: Picture, expected: ArrayLike, bar: float,
    variance: ArrayLike = 0.0, tile: int = 8,
) -> list[Measurement]:  # fmt: skip
    """A picture against (h, w, 3) of some variance: its mean within the bar at 95 % confidence, and no tile that
    differs significantly."""
    mean, spread = made.mean, made.variance + variance
    truth = np.broadcast_to(np.asarray(expected, np.float64), mean.shape)
    total = float(truth.mean())
    # A pixel's channels come from the same paths: take them as fully correlated, the worst case.
    deviation = np.sqrt((np.sqrt(spread).sum(axis=-1) ** 2).sum()) / spread.size
    relative = abs(float(mean.mean()) - total) / total + 1.96 * float(deviation) / total
    tiles, right = tile_means(mean, tile), tile_means(truth, tile)
    # What rounding to float32 does is no evidence.
    floor = (1e-6 * (np.abs(tiles) + np.abs(right))) ** 2 + 1e-30
    z = np.abs(tiles - right) / np.sqrt(tile_means(spread, tile) / tile**2 + floor)
    most = NormalDist().inv_cdf(1 - _ALPHA / (2 * z.size))
    document, section = source
    return [
        Measurement(Rule(f"{name}: mean", document, section), relative, bar, "relative error"),
        Measurement(Rule(f"{name}: tiles", document, section), float(z.max()), most, "standard errors"),
    ]
