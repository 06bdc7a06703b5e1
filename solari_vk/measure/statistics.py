"""Tests and intervals with known error rates, for pictures, samplers and replicated runs.

p values and quantiles come from closed forms for whole degrees of freedom (Abramowitz and Stegun 1964, 26.4 and 26.7).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
ALPHA = 0.005  # family-wise level of the tiles of one picture
NORMAL_95 = 1.96


# ---- distributions ----------------------------------------------------------------------------------


def student_p(t: ArrayLike, degrees: int) -> Floats:
    """Two-sided p values of Student's t."""
    angle = np.arctan(np.abs(np.asarray(t, np.float64)) / math.sqrt(degrees))
    odd = degrees % 2
    term = np.cos(angle) if odd else np.ones_like(angle)
    series = np.zeros_like(angle)
    for power in range(odd, degrees - 1, 2):
        series += term
        term = term * np.cos(angle) ** 2 * ((power + 1) / (power + 2))
    inside = np.sin(angle) * series
    p_values: Floats = np.maximum(1 - (2 / np.pi * (angle + inside) if odd else inside), 0.0)
    return p_values


@lru_cache
def student_quantile(degrees: int, confidence: float = 0.95) -> float:
    """The t that bounds the two-sided interval of this confidence."""
    low, high = 0.0, 1e4
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if student_p(middle, degrees) > 1 - confidence else (low, middle)
    return high


def chi_squared_p(observed: ArrayLike, expected: ArrayLike, min_expected: float = 5.0) -> float:
    """Pearson's p value of counts against expected counts; cells below `min_expected` are pooled.

    Counts where nothing is expected give 0.
    """
    counts, means = (np.ravel(np.asarray(values, np.float64)) for values in (observed, expected))
    if counts[means <= 0].any():
        return 0.0
    order = np.argsort(means)
    counts, means = counts[order], means[order]
    pooled = max(int(np.searchsorted(means, min_expected)), int(np.searchsorted(means.cumsum(), min_expected)) + 1)
    if means[0] < min_expected:
        counts, means = (np.append(values[pooled:], values[:pooled].sum()) for values in (counts, means))
    x, degrees = float(((counts - means) ** 2 / means).sum()) / 2, len(means) - 1
    if degrees < 1 or x == 0:
        return 1.0
    odd = degrees % 2
    powers = [k + odd / 2 for k in range(degrees // 2)]
    terms = [math.exp(k * math.log(x) - x - math.lgamma(k + 1)) for k in powers]
    return min(math.fsum(terms) + (math.erfc(math.sqrt(x)) if odd else 0.0), 1.0)


def standard_deviations(p_value: float) -> float:
    """How many standard deviations above its mean a normal variable has this one-sided p value; infinite for 0."""
    if 0 < p_value < 1:
        return -NormalDist().inv_cdf(p_value)
    return math.inf if p_value <= 0 else -math.inf


# ---- many tests at once -----------------------------------------------------------------------------


def sidak(alpha: float, count: int) -> float:
    """The level of each of `count` independent tests for a family-wise level alpha."""
    return float(1 - (1 - alpha) ** (1 / max(count, 1)))


# ---- runs -------------------------------------------------------------------------------------------


def interval(values: ArrayLike) -> tuple[float, float]:
    """Mean of independent runs and the half width of its 95 % interval (Student's t), infinite for one run."""
    runs = np.ravel(np.asarray(values, np.float64))
    if len(runs) < 2:
        return float(runs.mean()), math.inf
    return float(runs.mean()), student_quantile(len(runs) - 1) * float(runs.std(ddof=1)) / math.sqrt(len(runs))


def relative_interval(observations: ArrayLike, expected: ArrayLike) -> tuple[float, float]:
    """Relative error of the mean of runs (R, ...) against the mean of `expected`, and its 95 % half width."""
    runs = np.asarray(observations, np.float64)
    return interval(runs.reshape(len(runs), -1).mean(axis=1) / float(np.mean(np.asarray(expected, np.float64))) - 1)


# ---- pictures ---------------------------------------------------------------------------------------


def tile_means(images: ArrayLike, size: int) -> Floats:
    """Means (..., rows, columns, channels) of size x size tiles of pictures (..., height, width, channels).

    Pixels at the right and bottom edge that fill no tile are left out.
    """
    pixels = np.asarray(images, np.float64)
    *front, height, width, channels = pixels.shape
    rows, columns = height // size, width // size
    cut = pixels[..., : rows * size, : columns * size, :]
    means: Floats = cut.reshape(*front, rows, size, columns, size, channels).mean(axis=(-4, -2))
    return means


def sixteenths(images: ArrayLike) -> Floats:
    """Means (..., 4, 4, channels) over the 4 x 4 parts of square pictures (..., side, side, channels)."""
    height, width, _ = np.shape(images)[-3:]
    assert height == width
    assert height % 4 == 0
    return tile_means(images, height // 4)


def relative_mse(image: NDArray[Any], reference: NDArray[Any]) -> float:
    """The mean of the squared error over the squared reference, to which 1 % of its squared mean is added."""
    floor = 1e-2 * float(np.mean(reference)) ** 2 + 1e-12
    return float(((image - reference) ** 2 / (reference**2 + floor)).mean())


@dataclass(frozen=True)
class Comparison:
    """Two pictures' tiles: z scores, the relative difference of the global means, and its 95 % half width."""

    z: Floats
    relative: float
    relative_half_width: float

    @property
    def max_z(self) -> float:
        """The largest absolute z score."""
        return float(np.abs(self.z).max())

    @property
    def z_bar(self) -> float:
        """What `max_z` exceeds with probability ALPHA when the pictures agree (the first step of Holm's procedure)."""
        return NormalDist().inv_cdf(1 - ALPHA / (2 * self.z.size))

    @property
    def reach(self) -> float:
        """How far from 0 the interval of the relative difference reaches."""
        return abs(self.relative) + self.relative_half_width

    def __str__(self) -> str:
        return (
            f"global {100 * self.relative:+.3f} % +- {100 * self.relative_half_width:.3f} %, largest |z| "
            f"{self.max_z:.2f} of {self.z.size}, bar {self.z_bar:.2f}, z rms {np.sqrt((self.z**2).mean()):.2f}"
        )


def compare(
    first: NDArray[Any], first_variance: ArrayLike, second: ArrayLike, second_variance: ArrayLike = 0.0, tile: int = 16
) -> Comparison:
    """Compare pictures (h, w, 3), given with the variances of their pixels' means, in tiles.

    Each channel of each tile is one normal test, since a tile averages hundreds of samples.
    """
    left, right, spread = (
        np.broadcast_to(np.asarray(values, np.float64), np.shape(first))
        for values in (first, second, np.add(first_variance, second_variance))
    )
    for image in (left, right, spread):
        assert np.isfinite(image).all(), "a picture or variance is not finite"
    mean_left, mean_right = tile_means(left, tile), tile_means(right, tile)
    # Rounding to float32 is no evidence of a difference.
    floor = (1e-6 * (np.abs(mean_left) + np.abs(mean_right))) ** 2 + 1e-30
    z = (mean_left - mean_right) / np.sqrt(tile_means(spread, tile) / tile**2 + floor)
    # A pixel's channels come from the same paths: take them as fully correlated, the worst case.
    deviation = math.sqrt(float((np.sqrt(spread).sum(axis=-1) ** 2).sum())) / spread.size
    total = float(right.mean())
    return Comparison(z, float(left.mean()) / total - 1, NORMAL_95 * deviation / total)


def true_relative_mse(image: NDArray[Any], first: NDArray[Any], second: NDArray[Any]) -> float:
    """relative_mse against the truth, of which two references with independent noise are given.

    The noise of a single reference adds its variance to the error. In the product of both differences it cancels out
    on average.
    """
    mean = (first + second) / 2
    floor = 1e-2 * float(np.mean(mean)) ** 2 + 1e-12
    return float(((image - first) * (image - second) / (mean**2 + floor)).mean())
