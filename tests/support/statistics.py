"""Measurements and what they require: statistical tests of samplers, runs and pictures, with known error rates."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray
from support.seeded_bugs import Measurement, Rule

from solari_vk.lab.measure.figures import interval

Floats = NDArray[np.float64]
ALPHA = 0.005  # family-wise level of the tiles of one picture
NORMAL_95 = 1.96


# ---- samplers and runs ----


def chi_squared_p(observed: ArrayLike, expected: ArrayLike, min_expected: float = 5.0) -> float:
    """Pearson's p value of counts against expected counts; cells below `min_expected` are pooled.

    Counts where nothing is expected give 0.
    """
    counts, means = (np.ravel(np.asarray(values, np.float64)) for values in (observed, expected))
    # A count where the density is 0 refutes the density, whatever the other cells hold.
    if counts[means <= 0].any():
        return 0.0
    # Pearson's statistic follows the chi-squared distribution only where a cell expects about 5 counts or more: the
    # smallest cells are pooled until their sum expects as many.
    order = np.argsort(means)
    counts, means = counts[order], means[order]
    pooled = max(int(np.searchsorted(means, min_expected)), int(np.searchsorted(means.cumsum(), min_expected)) + 1)
    if means[0] < min_expected:
        counts, means = (np.append(values[pooled:], values[:pooled].sum()) for values in (counts, means))
    return float(scipy.stats.chi2.sf(((counts - means) ** 2 / means).sum(), len(means) - 1)) if len(means) > 1 else 1.0


def standard_deviations(p_value: float) -> float:
    """How many standard deviations above its mean a normal variable has this one-sided p value; infinite for 0."""
    return float(scipy.stats.norm.isf(p_value))


def sidak(alpha: float, count: int) -> float:
    """The level of each of `count` independent tests for a family-wise level alpha."""
    return float(1 - (1 - alpha) ** (1 / max(count, 1)))


def relative_interval(observations: ArrayLike, expected: ArrayLike) -> tuple[float, float]:
    """Relative error of the mean of runs (R, ...) against the mean of `expected`, and its 95 % half width."""
    runs = np.asarray(observations, np.float64)
    return interval(runs.reshape(len(runs), -1).mean(axis=1) / float(np.mean(np.asarray(expected, np.float64))) - 1)


def uniform_p(x, y):
    """The p value of points (N,) in the unit square against the uniform density; 0 with any outside."""
    if min(x.min(), y.min()) < -1e-6 or max(x.max(), y.max()) > 1 + 1e-6:
        return 0.0
    counts, _, _ = np.histogram2d(np.clip(x, 0, 1), np.clip(y, 0, 1), 40, [[0, 1], [0, 1]])
    return chi_squared_p(counts, np.full(counts.shape, len(x) / counts.size))


def holm(p_values, alpha):
    """Which hypotheses Holm's step-down procedure rejects, boolean (N,)."""
    values = np.ravel(np.asarray(p_values, np.float64))
    order = np.argsort(values)
    rejected = np.zeros(len(values), bool)
    # Holm 1979: the smallest p value is tested at alpha / N, the next at alpha / (N - 1), until one isn't rejected.
    for rank, index in enumerate(order):
        if values[index] > alpha / (len(values) - rank):
            break
        rejected[index] = True
    return rejected


def compare_runs(observations, expected, bar):
    """The number of cells in which independent runs (R, ...) differ from the expected (...), and whether the mean is
    within the bar.

    Each cell is a Student t test over the runs; Holm's procedure decides which differ. The mean is within the bar when
    the 95 % interval of its relative error is.
    """
    runs = np.asarray(observations, np.float64)
    cells = runs.reshape(len(runs), -1)
    truth = np.broadcast_to(np.asarray(expected, np.float64), runs.shape[1:]).ravel()
    # The runs are independent, so their spread gives the standard error of the mean; t has runs - 1 degrees of freedom.
    error = cells.std(axis=0, ddof=1) / math.sqrt(len(runs))
    t = (cells.mean(axis=0) - truth) / np.maximum(error, 1e-7 * np.abs(truth) + 1e-30)
    mean, half_width = relative_interval(runs, truth)
    return int(holm(2 * scipy.stats.t.sf(np.abs(t), len(runs) - 1), ALPHA).sum()), abs(mean) + half_width <= bar


# ---- pictures ----


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


def tile_means_4x4(images: ArrayLike) -> Floats:
    """Means (..., 4, 4, channels) over the 4 x 4 parts of square pictures (..., side, side, channels)."""
    height, width, _ = np.shape(images)[-3:]
    assert height == width
    assert height % 4 == 0
    return tile_means(images, height // 4)


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
        return float(scipy.stats.norm.isf(ALPHA / (2 * self.z.size)))

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


def assert_equal(comparison, bar, what=""):
    """Require that no tile differs significantly, and that the interval of the global relative difference lies inside
    the bar."""
    assert comparison.max_z <= comparison.z_bar, f"{what}: {comparison}"
    assert comparison.reach <= bar, f"{what}: {comparison}"


# ---- measurements of frames and pictures ----


def measure_mean(rule, observations, expected, bar, effort):
    """The end of the 95 % interval of the mean's relative error that is farther from 0."""
    error, half_width = relative_interval(observations, expected)
    note = f"{error:+.2%} +- {half_width:.2%}"
    return Measurement(rule, abs(error) + half_width, bar, f"relative error, {effort}", note)


def measure_picture_tiles(rule, observations, expected, bar, effort):
    """The largest relative error of 4 x 4 tiles of a square picture."""
    found, right = (tile_means_4x4(image).mean(axis=-1) for image in (observations.mean(axis=0), expected))
    errors = found / right - 1
    note = f"tiles {np.round(100 * errors, 1).tolist()} %"
    return Measurement(rule, float(np.abs(errors).max()), bar, f"relative error, {effort}", note)


def measure_tiles_t(rule, observations, expected):
    """The largest Student's t of 4 x 4 tiles and their channels between runs (R, h, w, 3) and `expected`: a picture, or
    other runs. Chance exceeds the bar once in 1,000 runs at most."""
    ours, theirs = tile_means_4x4(observations), tile_means_4x4(expected)
    # The standard errors of both sides add up as squares; a picture without runs is taken as exact. The floor of 1e-5
    # stands for the rounding of float32.
    errors = [scipy.stats.sem(runs) for runs in (ours, theirs) if runs.ndim == 4]
    right = theirs.mean(axis=0) if theirs.ndim == 4 else theirs
    t = np.abs(ours.mean(axis=0) - right) / (np.linalg.norm(errors, axis=0) + 1e-5 * right + 1e-30)
    worst = np.unravel_index(t.argmax(), t.shape)
    note = f"row {worst[0]}, column {worst[1]}: {ours.mean(axis=0)[worst] / max(right[worst], 1e-30) - 1:+.2%}"
    # Two-sided, and shared out over all tiles and channels (Bonferroni).
    bar = float(scipy.stats.t.isf(0.5e-3 / t.size, len(ours) - 1))
    return Measurement(rule, float(t.max()), bar, "standard errors", note)


def compare_picture(name, source, made, expected, bar, variance=0.0, tile=8):
    """Compare a picture with `expected` (h, w, 3): the mean within the bar, and each tile within statistical error."""
    found = compare(made.mean, made.variance, expected, variance, tile)
    mean, tiles = (Rule(f"{name}: {part}", *source) for part in ("mean", "tiles"))
    return [
        Measurement(mean, found.reach, bar, "relative error"),
        Measurement(tiles, found.max_z, found.z_bar, "standard errors"),
    ]
