"""Tests that know their error rate, for pictures and samplers (see the protocols in the testing notes)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from solari_vk.conformance.pictures import tile_means as tile_means


def sidak(alpha, count):
    """The level of each of `count` independent tests for a family-wise level alpha."""
    return 1 - (1 - alpha) ** (1 / max(count, 1))


def holm(p_values, alpha):
    """Which hypotheses Holm's step-down procedure rejects, boolean (N,)."""
    p_values = np.asarray(p_values, np.float64)
    order = np.argsort(p_values)
    rejected = np.zeros(len(p_values), bool)
    for rank, index in enumerate(order):
        if p_values[index] > alpha / (len(p_values) - rank):
            break
        rejected[index] = True
    return rejected


def chi_squared_p(observed, expected, least=5.0):
    """Pearson's p value of counts against expected counts; cells below `least` are pooled.

    Counts where nothing is expected give 0 at once.
    """
    observed, expected = np.ravel(observed).astype(np.float64), np.ravel(expected).astype(np.float64)
    if observed[expected <= 0].any():
        return 0.0
    order = np.argsort(expected)
    observed, expected = observed[order], expected[order]
    small = expected < least
    observed = np.append(observed[~small], observed[small].sum())
    expected = np.append(expected[~small], expected[small].sum())
    if expected[-1] < least and len(expected) > 1:
        observed[-2] += observed[-1]
        expected[-2] += expected[-1]
        observed, expected = observed[:-1], expected[:-1]
    statistic = ((observed - expected) ** 2 / expected).sum()
    return float(stats.chi2.sf(statistic, len(expected) - 1))


@dataclass
class Comparison:
    """Two pictures' tiles: z scores, the relative difference of the global means, and its 95 % half width."""

    z: np.ndarray
    relative: float
    relative_half_width: float
    tiles_rejected: int

    def assert_equal(self, bar, what=""):
        """No tile differs significantly, and the interval of the global relative difference lies inside the bar."""
        worst = f"{what}: {self}"
        assert self.tiles_rejected == 0, worst
        assert abs(self.relative) + self.relative_half_width <= bar, worst

    def __str__(self):
        return (
            f"global {100 * self.relative:+.3f} % +- {100 * self.relative_half_width:.3f} %, "
            f"largest |z| {np.abs(self.z).max():.2f} of {self.z.size}, {self.tiles_rejected} rejected, "
            f"z rms {np.sqrt((self.z**2).mean()):.2f}"
        )


def compare(first, first_variance, second, second_variance, tile=16, alpha=0.005):
    """Compare two pictures (h, w, 3) with the variances of their pixel means, in tiles.

    first and second are (h, w, 3). Each channel of each tile is one test, by Holm at family-wise alpha;
    normal, since a tile averages hundreds of samples. Floors of 1e-6 of the mean keep float32 rounding
    from counting as evidence.
    """
    for image in (first, first_variance, second, second_variance):
        assert np.isfinite(image).all(), "a picture or variance is not finite"
    mean_a, mean_b = tile_means(first, tile), tile_means(second, tile)
    variance = (tile_means(first_variance, tile) + tile_means(second_variance, tile)) / tile**2
    floor = (1e-6 * (np.abs(mean_a) + np.abs(mean_b))) ** 2 + 1e-30
    z = (mean_a - mean_b) / np.sqrt(variance + floor)
    rejected = holm(2 * stats.norm.sf(np.abs(z)).ravel(), alpha)
    total = float(np.asarray(second, np.float64).mean())
    # A pixel's channels come from the same paths: take them as fully correlated, the worst case.
    deviation = np.sqrt(np.asarray(first_variance, np.float64) + second_variance).reshape(*first.shape[:2], -1)
    spread = np.sqrt((deviation.sum(axis=-1) ** 2).sum()) / deviation.size
    difference = float(np.asarray(first, np.float64).mean()) - total
    return Comparison(z, difference / total, 1.96 * float(spread) / total, int(rejected.sum()))


def replicates(observations, truth, bar, alpha=0.005):
    """P-REPL over independent runs (R, ...) against truth (...): (Holm rejections, whether within the bar).

    Each cell is a Student t test over the runs; within the bar means that the 95 % interval of the
    global mean's relative error lies inside it.
    """
    observations, truth = np.asarray(observations, np.float64), np.asarray(truth, np.float64)
    runs = len(observations)
    cells = observations.reshape(runs, -1)
    expected = np.broadcast_to(truth, observations.shape[1:]).ravel()
    error = cells.std(axis=0, ddof=1) / np.sqrt(runs)
    difference = cells.mean(axis=0) - expected
    t = difference / np.maximum(error, 1e-7 * np.abs(expected) + 1e-30)
    rejected = holm(2 * stats.t.sf(np.abs(t), runs - 1), alpha)
    relative = cells.mean(axis=1) / expected.mean() - 1
    half_width = stats.t.ppf(0.975, runs - 1) * relative.std(ddof=1) / np.sqrt(runs)
    return int(rejected.sum()), bool(abs(relative.mean()) + half_width <= bar)


def relative_mse(image, reference, epsilon=1e-2):
    """relMSE, finite pictures only."""
    assert np.isfinite(image).all()
    return float(((image - reference) ** 2 / (reference**2 + epsilon)).mean())
