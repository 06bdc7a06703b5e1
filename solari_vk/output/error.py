"""How far a picture is from the truth, estimated without the truth.

Errors are relative: the root of relMSE, which is the squared error of luminance divided by the squared luminance, to
which 1 % of the picture's squared mean is added, on average over the picture. So an error of 0.01 says that pixels are
typically off by 1 % of their luminance, and black pixels count little. Luminance and its error are taken as means over
blocks of 4x4 pixels, because the few samples of one pixel know neither.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.output.tone_mapping import LUMINANCE

BLOCK = 4
Floats = NDArray[np.float64]


def error_of_mean(mean: NDArray[Any], variance: NDArray[Any]) -> float:
    """The error of a mean (height, width, 3) of unbiased samples. variance (height, width): of the mean's luminance."""
    return math.sqrt(relative_squares(mean, variance).mean())


def error_of_other(picture: NDArray[Any], mean: NDArray[Any], variance: NDArray[Any]) -> float:
    """The error of any picture (height, width, 3), such as a denoised one, by comparison with samples not in it.

    mean (height, width, 3): of these samples, which are unbiased. variance (height, width): of the mean's luminance.
    The squared difference of picture and mean is on average the variance plus the picture's squared error, bias
    included. One standard error is added, because the samples may be near the picture by chance. A block counts as off
    by 100 % at most, so that a few bright samples don't decide.
    """
    difference = luminance(picture) - luminance(mean)
    squares = np.clip(relative_squares(picture, difference**2 - variance), -1, 1)
    return math.sqrt(max(float(squares.mean()), 0.0) + float(squares.std()) / math.sqrt(squares.size))


class ErrorEstimate:
    """The estimated error of a picture whose samples grow in number.

    The owner looks when there are `next_count` samples or more. A denoised picture is compared with as many later
    samples as it has, so its error is that of half the samples, and the picture at hand is better. first: the first
    number of samples to look at, at least 2.
    """

    def __init__(self, first: int) -> None:
        self.error = math.inf
        self.next_count = first
        self._held: tuple[int, NDArray[Any], Floats, NDArray[Any]] | None = None

    def look_at_mean(self, count: int, mean: NDArray[Any], variance: NDArray[Any]) -> None:
        """The picture is the mean (height, width, 3) of independent samples; variance is that of its luminance."""
        self.error = error_of_mean(mean, variance)
        self.next_count = math.ceil(1.25 * count)

    def look_at_other(
        self, count: int, mean: NDArray[Any], variance: NDArray[Any], picture: Callable[[], NDArray[Any]]
    ) -> None:
        """The picture is something else made of these samples."""
        deviations = variance.astype(np.float64) * count * (count - 1)
        if self._held is not None:
            earlier, earlier_mean, earlier_deviations, earlier_picture = self._held
            later = count - earlier
            later_mean = (count * mean.astype(np.float64) - earlier * earlier_mean) / later
            # Chan, Golub and LeVeque, "Updating Formulae and a Pairwise Algorithm for Computing Sample Variances"
            apart = (luminance(later_mean) - luminance(earlier_mean)) ** 2
            own = np.maximum(deviations - earlier_deviations - apart * earlier * later / count, 0)
            self.error = error_of_other(earlier_picture, later_mean, own / (later * (later - 1)))
        self._held = count, mean, deviations, picture()
        self.next_count = 2 * count


class RunningMean:
    """The mean of pictures, and the variance of the mean's luminance as if they were independent."""

    def __init__(self) -> None:
        self.count = 0
        self._mean: Any = 0.0
        self._deviations: Any = 0.0

    def add(self, picture: NDArray[Any]) -> None:
        """Add a picture (height, width, 3)."""
        self.count += 1
        apart = picture.astype(np.float64) - self._mean
        self._mean = self._mean + apart / self.count
        # Welford, "Note on a Method for Calculating Corrected Sums of Squares and Products" (1962)
        self._deviations = self._deviations + luminance(apart) * luminance(picture - self._mean)

    @property
    def mean(self) -> Floats:
        """(height, width, 3)."""
        return np.asarray(self._mean)

    @property
    def variance(self) -> Floats:
        """(height, width), of at least two pictures."""
        return np.asarray(self._deviations / (self.count * (self.count - 1)))


def luminance(picture: NDArray[Any]) -> Floats:
    """Of a picture (..., 3)."""
    return picture.astype(np.float64) @ LUMINANCE.astype(np.float64)


def relative_squares(picture: NDArray[Any], squares: NDArray[Any]) -> Floats:
    """Squared errors (height, width) relative to the squared luminance of a picture (height, width, 3), for blocks."""
    light = luminance(picture)
    floor = 1e-2 * float(light.mean()) ** 2 or 1.0
    relative: Floats = _blocks(squares) / (_blocks(light) ** 2 + floor)
    return relative


def _blocks(values: NDArray[Any]) -> Floats:
    """Means of blocks; those at the right and lower edge may be smaller."""
    rows, columns = (np.arange(0, side, BLOCK) for side in values.shape)
    sums = np.add.reduceat(np.add.reduceat(values.astype(np.float64), rows, 0), columns, 1)
    heights, widths = (np.diff(np.append(at, side)) for at, side in zip((rows, columns), values.shape, strict=True))
    means: Floats = sums / np.outer(heights, widths)
    return means
