"""Wall-clock times of work on the host and the device."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

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

    device.wait_idle()
    return seconds(run)


def best_seconds(device: Device, work: Work, total: float) -> float:
    """The smallest `device_seconds` of as many runs as `total` seconds allow, at least one."""
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
