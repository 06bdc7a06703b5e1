"""Errors of pictures, and intervals of means over runs."""

from __future__ import annotations

import importlib.util
import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


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


def squared_scale(reference: NDArray[Any]) -> NDArray[Any]:
    """What relMSE divides squared errors by: the squared reference, plus 1 % of its squared mean."""
    scale: NDArray[Any] = reference**2 + (1e-2 * float(np.mean(reference)) ** 2 + 1e-12)
    return scale


def relative_mse(image: NDArray[Any], reference: NDArray[Any]) -> float:
    """The mean of the squared error over the squared reference, to which 1 % of its squared mean is added."""
    return float(((image - reference) ** 2 / squared_scale(reference)).mean())


def true_relative_mse(image: NDArray[Any], first: NDArray[Any], second: NDArray[Any]) -> float:
    """relative_mse against the truth, of which two references with independent noise are given.

    The noise of a single reference adds its variance to the error. In the product of both differences it cancels out
    on average.
    """
    return float(((image - first) * (image - second) / squared_scale((first + second) / 2)).mean())


def flip(image: NDArray[Any] | None, reference: NDArray[Any], exposure: float) -> float:
    """The mean FLIP at five exposures around the camera's, a stop apart; NaN without its package or an image."""
    if image is None or importlib.util.find_spec("flip_evaluator") is None:
        return math.nan
    import flip_evaluator

    given = (np.maximum(picture, 0.0).astype(np.float32) for picture in (reference, image))
    middle = math.log2(exposure)
    exposures = {"startExposure": middle - 2, "stopExposure": middle + 2, "numExposures": 5}
    return float(flip_evaluator.evaluate(*given, "HDR", applyMagma=False, parameters=exposures)[1])
