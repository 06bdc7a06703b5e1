"""Numbers of samples by pixel, so that a picture reaches an error in the least time."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.output.error import Floats, error_of_mean, luminance

MIN_SAMPLES = 16  # of any pixel; fewer don't tell a variance
GROWTH = 1.5  # of a pixel's number of samples in one pass, at most
ESTIMATES = 5  # the number of earlier ones that the next is compared with
AIM = 0.95  # of the target, since errors are estimates


class SamplePlan:
    """How many samples each pixel takes, pass by pass. The owner traces a pass, has the error estimated, and begins the
    next one.

    The numbers are in proportion to sqrt(variance / cost), which a mean over the picture needs (Neyman, "On the Two
    Different Aspects of the Representative Method", 1934); cost is counted in rays. Blocks of pixels are divided
    like checkerboards in two cells, and what one cell needs is told by the other cells around it: pixels that stop
    because of their own samples are too dark where bright samples are rare (Kirk and Arvo, "Unbiased Sampling
    Techniques for Image Synthesis", 1991). size: (width, height). block: the pixels on a side of a block, which the
    device traces together. samples: the number that all pixels have already.
    """

    def __init__(self, size: tuple[int, int], block: int, samples: int = 0) -> None:
        width, height = size
        # Two cells a block, the black and the white fields of a checkerboard. A cell's number is that of its block,
        # times two, and its color.
        rows, columns = np.indices((height, width))
        blocks = math.ceil(height / block), math.ceil(width / block)
        self.cells = 2 * (rows // block * blocks[1] + columns // block) + (rows + columns) % 2
        """The cell (height, width) of each pixel: 0 and 1 those of the first block, and so on row by row."""
        self._grid = *blocks, 2
        self._pixels = np.bincount(self.cells.ravel(), minlength=math.prod(self._grid))
        self.begins = np.full(len(self._pixels), samples, np.int64)
        """The samples of each cell's pixels before this pass."""
        self.ends = self.begins.copy()
        """Those after it."""
        self.traced = 0
        """The samples of this pass that have been traced; pixels that take fewer in it have all of theirs."""
        self.error = math.inf
        self._squares = np.full((height, width), np.inf)  # variance of the mean's luminance
        # Of the latest passes: the samples of the cells, and the luminance of the mean.
        self._estimates: list[tuple[NDArray[np.int64], Floats]] = []

    @property
    def remaining(self) -> int:
        """The samples that pixels take in the rest of this pass, at most."""
        return max(int((self.ends - self.begins).max()) - self.traced, 0)

    @property
    def samples(self) -> int:
        """The samples of the pixel that has most."""
        return int(self._counts().max())

    @property
    def counts(self) -> NDArray[np.int64]:
        """The samples (height, width) of each pixel."""
        return self._counts()[self.cells]

    def begin_even_pass(self) -> None:
        """Begin a pass after which all pixels have as many samples as the one that has most."""
        self._begin_pass(np.full(len(self._pixels), self.samples))

    def begin_pass_towards(self, target: float, limit: int) -> None:
        """Begin a pass towards an error. Nothing remains if it is reached, or if all pixels have `limit` samples."""
        counts = self._counts()
        if self.error <= target:
            wanted = counts
        # The first passes give all pixels as many, until their variances are known.
        elif counts.min() < MIN_SAMPLES or not math.isfinite(self.error):
            wanted = np.full_like(counts, max(math.ceil(GROWTH * counts.max()), 1))
        else:
            # In small steps, because variances that few samples tell are rough.
            needed = np.minimum(self._needed(AIM * target), GROWTH * counts)
            wanted = np.maximum(np.ceil(needed).astype(np.int64), counts)
            if (wanted == counts).all():  # all should have enough, and the error is still too large
                wanted = np.ceil(GROWTH * counts).astype(np.int64)
        self._begin_pass(np.minimum(wanted, limit))

    def estimate_error(self, mean: NDArray[Any], rays: NDArray[Any]) -> None:
        """Estimate the picture's error after a pass.

        mean: (height, width, 3). rays (height, width): of each pixel's samples so far. The variance of a mean is
        estimated from the means of about the first half of its samples and of the rest, since the variance of single
        samples overestimates that of points of low-discrepancy sequences.
        """
        light = luminance(mean)
        counts = self._counts()
        # Of each cell's earlier estimates the one with about half of today's samples.
        half = np.zeros_like(counts)
        earlier = np.zeros_like(light)
        for count, estimate in self._estimates:
            nearer = (abs(2 * count - counts) < abs(2 * half - counts)) & (count < counts)
            half = np.where(nearer, count, half)
            earlier = np.where(nearer[self.cells], estimate, earlier)
        # earlier - light is the difference of the means of both halves, times the rest's share of the samples. Of
        # independent samples the expectation of its square is the variance of the whole mean, times rest / half.
        ratio = (half / np.maximum(counts - half, 1))[self.cells]
        self._squares = np.where(ratio > 0, (earlier - light) ** 2 * ratio, self._squares)
        self.error = error_of_mean(mean, self._squares)
        self._estimates = [*self._estimates[1 - ESTIMATES :], (counts, light)]
        self._light = light
        self._rays = self._means(rays) / np.maximum(counts, 1)

    def _counts(self) -> NDArray[np.int64]:
        return np.minimum(self.begins + self.traced, self.ends)

    def _begin_pass(self, wanted: NDArray[np.int64]) -> None:
        self.begins = self._counts()
        self.traced = 0
        self.ends = np.maximum(wanted, self.begins)

    def _needed(self, target: float) -> Floats:
        """The samples of each cell for an error."""
        errors = self._means(self._squares) / (self._means(self._light) ** 2 + 1e-2 * float(self._light.mean()) ** 2)
        share = self._pixels / self._pixels.sum()
        allowed = float(share @ errors) * (target / self.error) ** 2  # the target, in the units of `errors`
        variance = self._of_other_cells(errors * self._counts())
        cost = np.maximum(self._of_other_cells(self._rays), 1.0)
        needed: Floats = np.sqrt(variance / cost) * (float(share @ np.sqrt(variance * cost)) / allowed)
        return needed

    def _means(self, values: NDArray[Any]) -> Floats:
        """The means of values (height, width) over each cell."""
        return np.bincount(self.cells.ravel(), values.ravel(), len(self._pixels)) / np.maximum(self._pixels, 1)

    def _of_other_cells(self, values: Floats) -> Floats:
        """For each cell the mean over the other cells of its block and of the eight blocks around it."""

        def sums(numbers: NDArray[Any]) -> Floats:
            padded = np.pad(numbers.reshape(self._grid), ((1, 1), (1, 1), (0, 0)))
            around = np.lib.stride_tricks.sliding_window_view(padded, (3, 3), (0, 1)).sum(axis=(-2, -1))
            # What the black cells of these blocks have counts for the white cell, and the other way round.
            found: Floats = around[..., ::-1].ravel()
            return found

        return sums(values * self._pixels) / np.maximum(sums(self._pixels), 1)
