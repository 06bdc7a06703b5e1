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

SEEDS_OF_PICTURES = 1, 2  # of the two halves; others are for the times
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
        return float(np.mean((first - second) ** 2 / squared_scale(self.picture)) / 4)

    @property
    def mean_error(self) -> Picture:
        """The standard error (3,) of the means of red, green and blue, over the means."""
        first, second = (half.picture for half in self.halves)
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
        order = sorted(self.results, key=lambda name: name != OURS)
        return {(a, b): distance(self.results[a], self.results[b], self.exposure) for a, b in combinations(order, 2)}


def compare(
    start: Mapping[str, Callable[[], Process]], samples: int, goals: Sequence[Goal], progress: Callable[[str], None]
) -> Comparison:
    """Start renderers, render a picture of each, and measure the times to the goals."""
    found = Comparison()
    processes: dict[str, Process] = {}

    def attempt(name: str, work: Callable[[], Any]) -> Any:
        try:
            return work()
        except Failure as failure:
            found.failures[name] = str(failure)
            progress(f"{name}: {failure}")
            if name in processes:
                processes.pop(name).close()
            return None

    try:
        for name, begin in start.items():
            progress(f"{name}: loading")
            if (process := attempt(name, begin)) is not None:
                processes[name] = process
        halves: dict[str, list[Render]] = {name: [] for name in processes}
        for seed in SEEDS_OF_PICTURES:
            for name in list(processes):
                progress(f"{name}: {math.ceil(samples / 2)} samples")
                half = attempt(name, lambda: processes[name].render(math.ceil(samples / 2), seed))  # noqa: B023
                halves[name] += [] if half is None else [half]
        for name, pair in halves.items():
            if len(pair) == len(SEEDS_OF_PICTURES):
                found.results[name] = Result(pair, processes[name].loading)
        for goal in goals:
            _measure_times(found, processes, samples, goal, attempt, progress)
    finally:
        for process in processes.values():
            process.close()
    return found


def _measure_times(
    found: Comparison,
    processes: dict[str, Process],
    samples: int,
    goal: Goal,
    attempt: Callable[[str, Callable[[], Any]], Any],
    progress: Callable[[str], None],
) -> None:
    """Double the samples of each renderer until its error is small enough; renderers take turns."""
    seed = SEEDS_OF_PICTURES[-1]
    # A smaller error takes no fewer samples.
    count = min(
        (
            max(
                (
                    reached.samples
                    for other, reached in found.results[name].reached.items()
                    if other.denoised == goal.denoised and other.error >= goal.error
                ),
                default=1,
            )
            for name in processes
        ),
        default=1,
    )
    while count <= samples:
        waiting = [
            name
            for name in processes
            if goal not in found.results[name].reached and (KINDS[name].denoises or not goal.denoised)
        ]
        if not waiting:
            return
        denoised = " denoised" * goal.denoised
        progress(f"{', '.join(waiting)}: time to a relMSE of {goal.error:g}{denoised}, {count} samples")
        renders: dict[str, list[Render]] = {name: [] for name in waiting}
        for _ in range(REPETITIONS):
            seed += 1
            for name in [name for name in waiting if name in processes]:
                done = attempt(name, lambda: processes[name].render(count, seed, goal.denoised))  # noqa: B023
                renders[name] += [] if done is None else [done]
        for name, done in renders.items():
            if name in processes:
                reached = median(found.results[name].error(render.picture) for render in done)
                if reached <= goal.error:
                    seconds, processor = (
                        median(getattr(render, what) for render in done) for what in ("seconds", "processor_seconds")
                    )
                    found.results[name].reached[goal] = Reached(count, reached, seconds, processor)
        count *= 2
