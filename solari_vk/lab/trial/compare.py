"""Distances between pictures of renderers, whose noise cancels out, and how long each takes to an error."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from itertools import combinations
from statistics import median
from typing import Any

import numpy as np

from solari_vk.lab.trial.process import KINDS, OURS, Failure, Picture, Process, Render
from solari_vk.output.compare import flip, squared_scale, true_relative_mse

SEEDS_OF_PICTURES = (1, 2)  # of the two halves; others are for the times
REPETITIONS = 3


@dataclass(frozen=True)
class Goal:
    """A relMSE, of pictures as they are rendered or denoised."""

    error: float
    denoised: bool = False


@dataclass(frozen=True)
class Reached:
    """The smallest number of samples, in doublings from 1 on, at which a renderer's error is small enough.

    error: the relMSE there; seconds and processor_seconds: of such a picture; each the median of REPETITIONS."""

    samples: int
    error: float
    seconds: float
    processor_seconds: float


@dataclass
class Result:
    """What a renderer made of a scene. halves: two pictures with independent noise, whose mean is the picture."""

    halves: list[Render]
    loading: float
    reached: dict[Goal, Reached] = field(default_factory=dict)

    @property
    def time(self) -> Reached | None:
        """The time to the only goal of a trial, None if it wasn't reached."""
        return next(iter(self.reached.values()), None)

    @property
    def picture(self) -> Picture:
        """The mean of both halves."""
        mean: Picture = (self.halves[0].picture + self.halves[1].picture) / 2
        return mean

    @property
    def noise(self) -> float:
        """The relMSE of the picture that is noise, from what its halves differ by."""
        first, second = (half.picture for half in self.halves)
        # The difference of two halves has twice the variance of one, and their mean half of it: a quarter.
        return float(np.mean((first - second) ** 2 / squared_scale(self.picture)) / 4)

    @property
    def mean_error(self) -> Picture:
        """The standard error (3,) of the means of red, green and blue, over the means."""
        first, second = (half.picture for half in self.halves)
        # The halves estimate the variance of each pixel; pixels are independent.
        spread = np.sqrt(((first - second) ** 2).sum(axis=(0, 1))) / 2
        found: Picture = spread / np.maximum((first + second).sum(axis=(0, 1)) / 2, 1e-12)
        return found

    def error(self, picture: Picture) -> float:
        """The relMSE of another picture of the same renderer; the noise of the halves cancels out."""
        return true_relative_mse(picture, *(half.picture for half in self.halves))

    def facts(self) -> dict[str, Any]:
        """Numbers for the page."""
        spent = {name: sum(getattr(half, name) for half in self.halves) for name in ("seconds", "processor_seconds")}
        reached = None if self.time is None else asdict(self.time)
        return {
            "mean": self.picture.mean(axis=(0, 1)).tolist(),
            "noise": self.noise,
            "loading": self.loading,
            **spent,
            "reached": reached,
        }


@dataclass(frozen=True)
class Distance:
    """How far a picture is from another: the relMSE without both noises, the mean FLIP (NaN without its package), and
    the ratio of the means of red, green and blue, with the largest of its three standard errors."""

    relative_mse: float
    flip: float
    ratio: tuple[float, ...]
    ratio_error: float


def distance(first: Result, second: Result, exposure: float) -> Distance:
    """The distance between two renderers; the relMSE is relative to the mean of both.

    The product of the differences of independent halves has no noise on average, so it may be a little below 0.
    """
    a, b = ([half.picture for half in result.halves] for result in (first, second))
    # Noise of the first halves is independent of that of the second ones.
    product = (a[0] - b[0]) * (a[1] - b[1]) / squared_scale((first.picture + second.picture) / 2)
    ratio = first.picture.mean(axis=(0, 1)) / np.maximum(second.picture.mean(axis=(0, 1)), 1e-12)
    error = float((ratio * np.hypot(first.mean_error, second.mean_error)).max())
    far = flip(first.picture, second.picture, exposure)
    return Distance(float(product.mean()), far, tuple(map(float, ratio)), error)


@dataclass
class Comparison:
    """All that is known of one scene. results and failures: by renderer; a failure may follow a result."""

    results: dict[str, Result] = field(default_factory=dict)
    failures: dict[str, str] = field(default_factory=dict)
    exposure: float = 1.0

    @cached_property
    def distances(self) -> dict[tuple[str, str], Distance]:
        """Of all pairs of renderers; ours comes first. They are computed once, when results and exposure are known,
        since a page is written after each scene."""
        # Ours first; the others keep the order in which they were asked for.
        order = sorted(self.results, key=lambda name: name != OURS)
        return {(a, b): distance(self.results[a], self.results[b], self.exposure) for a, b in combinations(order, 2)}


def compare(
    start: Mapping[str, Callable[[], Process]], samples: int, goals: Sequence[Goal], progress: Callable[[str], None]
) -> Comparison:
    """Start renderers, render a picture of each, and measure the times to the goals."""
    running = _Running(progress)
    try:
        for name, begin in start.items():
            running.start(name, begin)
        running.render_halves(math.ceil(samples / 2))
        for goal in goals:
            running.measure_times(goal, samples)
    finally:
        running.close()
    return running.found


class _Running:
    """The processes of renderers, and what they have made so far. One that fails is ended, and asked no more."""

    def __init__(self, progress: Callable[[str], None]) -> None:
        self.found = Comparison()
        self._processes: dict[str, Process] = {}
        self._progress = progress

    def start(self, name: str, begin: Callable[[], Process]) -> None:
        self._progress(f"{name}: loading")
        try:
            self._processes[name] = begin()
        except Failure as failure:
            self._end(name, failure)

    def close(self) -> None:
        for process in self._processes.values():
            process.close()

    def _end(self, name: str, failure: Failure) -> None:
        self.found.failures[name] = str(failure)
        self._progress(f"{name}: {failure}")
        if name in self._processes:
            self._processes.pop(name).close()

    def _render(self, name: str, samples: int, seed: int, denoise: bool = False) -> list[Render]:
        """A picture, or nothing if the renderer has failed, now or before."""
        if name not in self._processes:
            return []
        try:
            return [self._processes[name].render(samples, seed, denoise)]
        except Failure as failure:
            self._end(name, failure)
            return []

    def render_halves(self, samples: int) -> None:
        """The two pictures of each renderer whose mean is its result."""
        halves: dict[str, list[Render]] = {name: [] for name in self._processes}
        for seed in SEEDS_OF_PICTURES:
            for name in list(self._processes):
                self._progress(f"{name}: {samples} samples")
                halves[name] += self._render(name, samples, seed)
        for name, pair in halves.items():
            if len(pair) == len(SEEDS_OF_PICTURES):
                self.found.results[name] = Result(pair, self._processes[name].loading)

    def measure_times(self, goal: Goal, most_samples: int) -> None:
        """Double the samples of each renderer until its error is small enough; renderers take turns."""
        seed = SEEDS_OF_PICTURES[-1]
        # Renderers begin together, so that they take turns from the first picture on.
        count = min((self._least_samples(name, goal) for name in self._processes), default=1)
        while count <= most_samples:
            waiting = [name for name in self._processes if self._is_waiting(name, goal)]
            if not waiting:
                return
            kind = " denoised" if goal.denoised else ""
            self._progress(f"{', '.join(waiting)}: time to a relMSE of {goal.error:g}{kind}, {count} samples")
            renders: dict[str, list[Render]] = {name: [] for name in waiting}
            for _ in range(REPETITIONS):
                seed += 1
                for name in waiting:
                    renders[name] += self._render(name, count, seed, goal.denoised)
            for name, done in renders.items():
                if name in self._processes:
                    self._record_if_reached(name, goal, count, done)
            count *= 2

    def _least_samples(self, name: str, goal: Goal) -> int:
        """The samples from which on the goal can be reached: a smaller error takes no fewer than a larger one took."""
        reached = self.found.results[name].reached.items()
        counts = [
            made.samples for other, made in reached if other.denoised == goal.denoised and other.error >= goal.error
        ]
        return max(counts, default=1)

    def _is_waiting(self, name: str, goal: Goal) -> bool:
        can_reach = KINDS[name].denoises or not goal.denoised
        return can_reach and goal not in self.found.results[name].reached

    def _record_if_reached(self, name: str, goal: Goal, samples: int, renders: Sequence[Render]) -> None:
        result = self.found.results[name]
        error = median(result.error(render.picture) for render in renders)
        if error <= goal.error:
            seconds = median(render.seconds for render in renders)
            processor_seconds = median(render.processor_seconds for render in renders)
            result.reached[goal] = Reached(samples, error, seconds, processor_seconds)
