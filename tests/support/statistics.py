"""Statistical tests of samplers, runs and pictures, with known error rates."""

from __future__ import annotations

import math

import numpy as np

from solari_vk.measure.statistics import ALPHA, chi_squared_p, relative_interval, student_p


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
    for rank, index in enumerate(order):
        if values[index] > alpha / (len(values) - rank):
            break
        rejected[index] = True
    return rejected


def replicates(observations, expected, bar):
    """The number of cells in which independent runs (R, ...) differ from the expected (...), and whether the mean is
    within the bar.

    Each cell is a Student t test over the runs; Holm's procedure decides which differ. The mean is within the bar when
    the 95 % interval of its relative error is.
    """
    runs = np.asarray(observations, np.float64)
    cells = runs.reshape(len(runs), -1)
    truth = np.broadcast_to(np.asarray(expected, np.float64), runs.shape[1:]).ravel()
    error = cells.std(axis=0, ddof=1) / math.sqrt(len(runs))
    t = (cells.mean(axis=0) - truth) / np.maximum(error, 1e-7 * np.abs(truth) + 1e-30)
    mean, half_width = relative_interval(runs, truth)
    return int(holm(student_p(t, len(runs) - 1), ALPHA).sum()), abs(mean) + half_width <= bar


def assert_equal(comparison, bar, what=""):
    """Require that no tile differs significantly, and that the interval of the global relative difference lies inside
    the bar."""
    assert comparison.max_z <= comparison.z_bar, f"{what}: {comparison}"
    assert comparison.reach <= bar, f"{what}: {comparison}"
