"""How figures are taken: wall-clock times of work on the host and the device, and intervals of means over runs."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from solari_vk.gpu.device.device import Device

Work = Callable[[], object]


def seconds(work: Work) -> float:
    """The seconds that a call takes."""
    started = time.perf_counter()
    work()
    return time.perf_counter() - started


def device_seconds(device: Device, work: Work) -> float:
    """The seconds from a call, on an idle device, until the device is idle again."""

    def run() -> None:
        work()
        device.wait_idle()

    device.wait_idle()  # work that is still under way would count
    return seconds(run)


def best_seconds(device: Device, work: Work, total: float) -> float:
    """The smallest `device_seconds` of as many runs as `total` seconds allow, at least one."""
    # The smallest time is that with the least other work on the machine.
    times = [device_seconds(device, work)]
    while sum(times) < total:
        times.append(device_seconds(device, work))
    return min(times)


def warm(device: Device, work: Work, runs: int, total: float) -> None:
    """Run some work at least `runs` times and for `total` seconds: idle GPUs need a second to raise their clock."""
    until = time.perf_counter() + total
    while runs > 0 or time.perf_counter() < until:
        work()
        device.wait_idle()
        runs -= 1


@contextmanager
def every_barrier() -> Iterator[None]:
    """Frames that are made in this context put a barrier before each pass. Without it, passes that don't depend on each
    other overlap, and a pass's time includes work of the other."""
    before = os.environ.get("SOLARI_VK_BARRIERS")
    os.environ["SOLARI_VK_BARRIERS"] = "all"
    try:
        yield
    finally:
        del os.environ["SOLARI_VK_BARRIERS"]
        if before is not None:
            os.environ["SOLARI_VK_BARRIERS"] = before


def interval(values: ArrayLike) -> tuple[float, float]:
    """Mean of independent runs and the half width of its 95 % interval (Student's t), infinite for one run."""
    runs = np.ravel(np.asarray(values, np.float64))
    if len(runs) < 2:
        return float(runs.mean()), math.inf
    # ddof=1, because the spread is estimated about the mean of the same runs.
    return float(runs.mean()), _student_quantile(len(runs) - 1) * float(runs.std(ddof=1)) / math.sqrt(len(runs))


@lru_cache
def _student_quantile(degrees: int) -> float:
    """The t that bounds the two-sided 95 % interval, by bisection of the closed form of the probability within t for
    whole degrees of freedom (Abramowitz and Stegun 1964, 26.7.3 and 26.7.4): the package doesn't need scipy."""
    odd = degrees % 2
    low, high = 0.0, 1e4
    for _ in range(60):  # halves the interval to less than float64 can tell
        middle = (low + high) / 2
        angle = math.atan(middle / math.sqrt(degrees))
        term = math.cos(angle) if odd else 1.0
        series = 0.0
        # Each term follows from the one before it: by the squared cosine, and by the next even over the next odd
        # number, or the other way round.
        for power in range(odd, degrees - 1, 2):
            series += term
            term *= math.cos(angle) ** 2 * (power + 1) / (power + 2)
        within = math.sin(angle) * series
        within = 2 / math.pi * (angle + within) if odd else within
        if within < 0.95:
            low = middle
        else:
            high = middle
    return high
