"""Statistical tests of samplers, runs and pictures, with known error rates."""

import numpy as np
from scipy import stats

from solari_vk.measure.statistics import ALPHA, relative_interval


def uniform_p(x, y):
    """The p value of points (N,) in the unit square against the uniform density; 0 with any outside."""
    if min(x.min(), y.min()) < -1e-6 or max(x.max(), y.max()) > 1 + 1e-6:
        return 0.0
    counts, _, _ = np.histogram2d(np.clip(x, 0, 1), np.clip(y, 0, 1), 40, [[0, 1], [0, 1]])
    return float(stats.chisquare(counts, axis=None).pvalue)


def holm(p_values, alpha):
    """Which hypotheses Holm's step-down procedure rejects, boolean (N,)."""
    values = np.ravel(p_values)
    order = np.argsort(values)
    fails = values[order] > alpha / np.arange(len(values), 0, -1)
    rejected = np.zeros(len(values), bool)
    rejected[order[: fails.argmax() if fails.any() else len(values)]] = True
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
    t = (cells.mean(axis=0) - truth) / np.maximum(stats.sem(cells), 1e-7 * np.abs(truth) + 1e-30)
    mean, half_width = relative_interval(runs, truth)
    return int(holm(2 * stats.t.sf(np.abs(t), len(runs) - 1), ALPHA).sum()), abs(mean) + half_width <= bar


def assert_equal(comparison, bar, what=""):
    """Require that no tile differs significantly, and that the interval of the global relative difference lies inside
    the bar."""
    assert comparison.max_z <= comparison.z_bar, f"{what}: {comparison}"
    assert comparison.reach <= bar, f"{what}: {comparison}"
