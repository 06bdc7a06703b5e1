"""Pearson's test of draws against a density (P-CHI2)."""

from __future__ import annotations

import numpy as np
from scipy import stats


def p_value(observed, expected):
    """Of counts, cells below 5 expected pooled; 0 at once where something was drawn that can't be."""
    observed, expected = np.ravel(observed).astype(float), np.ravel(expected).astype(float)
    if observed[expected <= 0].any():
        return 0.0
    small = expected < 5
    observed = np.append(observed[~small], observed[small].sum())
    expected = np.append(expected[~small], expected[small].sum())
    if 0 < expected[-1] < 5:
        largest = expected[:-1].argmax()
        observed[largest] += observed[-1]
        expected[largest] += expected[-1]
        observed, expected = observed[:-1], expected[:-1]
    used = expected > 0
    statistic = ((observed[used] - expected[used]) ** 2 / expected[used]).sum()
    return float(stats.chi2.sf(statistic, max(used.sum() - 1, 1)))


def uniform_p_value(x, y, cells=(40, 40)):
    """Of points (N,) in the unit square against the uniform density; points outside fail at once."""
    inside = (x >= -1e-6) & (x <= 1 + 1e-6) & (y >= -1e-6) & (y <= 1 + 1e-6)
    if not inside.all():
        return 0.0
    counts, _, _ = np.histogram2d(np.clip(x, 0, 1), np.clip(y, 0, 1), cells, [[0, 1], [0, 1]])
    return p_value(counts, np.full(cells, len(x) / np.prod(cells)))


def level(test_count, alpha=0.01):
    """Sidak's level of each test for a family-wise level alpha."""
    return 1 - (1 - alpha) ** (1 / test_count)
