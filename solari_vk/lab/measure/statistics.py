"""Errors of pictures, and intervals of means over runs."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike


def interval(values: ArrayLike) -> tuple[float, float]:
    """Mean of independent runs and the half width of its 95 % interval (Student's t), infinite for one run."""
    runs = np.ravel(np.asarray(values, np.float64))
    if len(runs) < 2:
        return float(runs.mean()), math.inf
    return float(runs.mean()), _student_quantile(len(runs) - 1) * float(runs.std(ddof=1)) / math.sqrt(len(runs))


@lru_cache
def _student_quantile(degrees: int) -> float:
    """The t that bounds the two-sided 95 % interval, by bisection of the closed form of the probability within t for
    whole degrees of freedom (Abramowitz and Stegun 1964, 26.7.3 and 26.7.4): the package doesn't need scipy."""
    low, high, odd = 0.0, 1e4, degrees % 2
    for _ in range(60):
        middle = (low + high) / 2
        angle = math.atan(middle / math.sqrt(degrees))
        term, series = math.cos(angle) if odd else 1.0, 0.0
        for power in range(odd, degrees - 1, 2):
            series += term
            term *= math.cos(angle) ** 2 * (power + 1) / (power + 2)
        within = math.sin(angle) * series
        within = 2 / math.pi * (angle + within) if odd else within
        low, high = (middle, high) if within < 0.95 else (low, middle)
    return high
