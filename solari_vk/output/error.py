"""How far a picture is from the truth, estimated without the truth.

Errors are relative: the root of relMSE, which is the squared error of luminance divided by the squared luminance, to
which 1 % of the picture's squared mean is added, on average over the picture. So an error of 0.01 says that pixels are
typically off by 1 % of their luminance, and black pixels count little. Luminance and its error are taken as means over
blocks of 4x4 pixels, because the few samples of one pixel know neither.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.output.tone_mapping import LUMINANCE

BLOCK = 4
STEEPEST = 1.6  # p of a variance that falls as N^-p with the number of samples N: at most
Floats = NDArray[np.float64]


def error_of_mean(mean: NDArray[Any], variance: NDArray[Any]) -> float:
    """The error of a mean (height, width, 3) of unbiased samples. variance (height, width): of the mean's luminance."""
    return math.sqrt(relative_squares(mean, variance).mean())


def error_of_other(picture: NDArray[Any], first: NDArray[Any], second: NDArray[Any]) -> float:
    """The error of any picture (height, width, 3), such as a denoised one, by samples that aren't in it.

    first, second (height, width, 3): means without bias of two halves of these samples. The product of their
    differences from the picture is on average the picture's squared error, bias included, however noisy they are, if
    both are independent.
    One standard error is added, because they may be near the picture by chance. A block counts as off by 100 % at most,
    so that a few bright samples don't decide.
    """
    truth = luminance(picture)
    squares = np.clip(relative_squares(picture, (truth - luminance(first)) * (truth - luminance(second))), -1, 1)
    return math.sqrt(max(float(squares.mean()), 0.0) + float(squares.std()) / math.sqrt(squares.size))


class ErrorEstimate:
    """The estimated error of a picture whose samples grow in number.

    The owner looks when there are `next_look` samples or more. A picture that isn't their mean is compared with as
    many later samples as it has, so its error is that of half the samples, and the picture at hand is better. first:
    the first number of samples to look at.
    """

    def __init__(self, first: int) -> None:
        self.error = math.inf
        self.next_look = first
        self._picture: NDArray[Any] | None = None
        # Of earlier looks: the number of samples, the mean's luminance, and its squared error if p were 1.
        self._means: list[tuple[int, Floats, float]] = []
        self._sums: list[tuple[int, Floats]] = []  # numbers of samples, and their sums: with the picture, and later

    def add_mean(self, count: int, mean: NDArray[Any]) -> None:
        """The picture is the mean (height, width, 3) of its samples.

        Its variance is estimated from the means of about the first half and of the rest. With independent samples it is
        a quarter of their squared difference. Points of low-discrepancy sequences have variances that fall faster than
        1 / N, as N^-p; halves then differ by (2^p - 1) times as much, squared. p is that of earlier estimates.
        """
        light = luminance(mean)
        square = math.nan
        if self._means:
            first, earlier, before = min(self._means, key=lambda look: abs(look[0] - count / 2))
            square = error_of_mean(mean, (earlier - light) ** 2 * (first / (count - first))) ** 2
            fall = math.log(before / square) / math.log(count / first) if before > 0 and square > 0 else 1.0
            # 1 is that of independent samples; steeper estimates come from noise in two looks.
            power = min(max(fall, 1.0), STEEPEST)
            self.error = math.sqrt(square / (2**power - 1))
        # A first half is found among the looks from a third on.
        self._means = [look for look in self._means if look[0] >= count / 3] + [(count, light, square)]
        self.next_look = math.ceil(1.25 * count)

    def add_denoised(self, count: int, mean: NDArray[Any], picture: Callable[[], NDArray[Any]]) -> None:
        """The picture is something else made of samples with this mean (height, width, 3)."""
        self._sums.append((count, count * mean.astype(np.float64)))
        if len(self._sums) == 3:
            # Two halves of samples that came after the picture, which are independent of it and of each other.
            assert self._picture is not None
            halves = [(later[1] - sooner[1]) / (later[0] - sooner[0]) for sooner, later in pairwise(self._sums)]
            self.error = error_of_other(self._picture, *halves)
            del self._sums[:2]
        if len(self._sums) == 1:
            self._picture = picture()
            self.next_look = count + math.ceil(count / 2)
        else:
            self.next_look = 2 * self._sums[0][0]


def luminance(picture: NDArray[Any]) -> Floats:
    """Of a picture (..., 3)."""
    return picture.astype(np.float64) @ LUMINANCE.astype(np.float64)


def relative_squares(picture: NDArray[Any], squares: NDArray[Any]) -> Floats:
    """Squared errors (height, width) relative to the squared luminance of a picture (height, width, 3), for blocks."""
    light = luminance(picture)
    floor = 1e-2 * float(light.mean()) ** 2 or 1.0  # of a black picture
    relative: Floats = _blocks(squares) / (_blocks(light) ** 2 + floor)
    return relative


def _blocks(values: NDArray[Any]) -> Floats:
    """Means of blocks; those at the right and lower edge may be smaller."""
    rows, columns = (np.arange(0, side, BLOCK) for side in values.shape)
    sums = np.add.reduceat(np.add.reduceat(values.astype(np.float64), rows, 0), columns, 1)
    heights, widths = (np.diff(np.append(at, side)) for at, side in zip((rows, columns), values.shape, strict=True))
    means: Floats = sums / np.outer(heights, widths)
    return means


def area_means(picture: NDArray[Any], size: tuple[int, int]) -> Floats:
    """The means of a picture (height, width, channels) over the pixels of one of another width and height."""
    # Differences of running sums at the edges of the wider pixels, which may lie within a narrow one.
    result = picture.astype(np.float64)
    for axis, count in enumerate(size[::-1]):
        length = result.shape[axis]
        sums = np.insert(np.cumsum(result, axis), 0, 0.0, axis)
        edges = np.linspace(0, length, count + 1)
        below = np.minimum(edges.astype(int), length - 1)
        parts = np.expand_dims(edges - below, [other for other in range(result.ndim) if other != axis])
        low = np.take(sums, below, axis)
        high = np.take(sums, below + 1, axis)
        result = np.diff(low + parts * (high - low), axis=axis) * (count / length)
    return result
