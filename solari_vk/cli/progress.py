"""The progress of long commands, and how they end early."""

from __future__ import annotations

import signal
import sys
import time
from typing import Any


class Stopped(Exception):
    """Ctrl-C was pressed or the time limit is over; what is rendered so far counts."""


class Progress:
    """Shows progress: a bar on a terminal, otherwise a line every few seconds. A context manager.

    Call it with the number of units that are done. The call raises Stopped after Ctrl-C, or `time_limit` seconds after
    the first call: the time before it, in which a driver compiles, doesn't count. A second Ctrl-C ends the program.
    """

    def __init__(self, unit: str, total: int, time_limit: float | None = None) -> None:
        self._unit, self._total, self._time_limit = unit, total, time_limit
        self._started = self._said = time.monotonic()
        self._called = self._interrupted = False
        self._bar: Any = None

    def __enter__(self) -> Progress:
        self._previous_handler = signal.signal(signal.SIGINT, self._interrupt)
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

            self._bar = Progress(
                self._unit, BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), console=Console(stderr=True)
            )
            self._bar.start()
            self._task = self._bar.add_task("", total=self._total)
        return self

    def __exit__(self, *_: object) -> None:
        signal.signal(signal.SIGINT, self._previous_handler)
        if self._bar is not None:
            self._bar.stop()

    @property
    def seconds(self) -> float:
        """The seconds since the first call."""
        return time.monotonic() - self._started

    def __call__(self, done: int) -> None:
        if not self._called:
            self._called, self._started = True, time.monotonic()
        if self._interrupted:
            raise Stopped(f"interrupted: keeping {done} {self._unit}")
        if self._time_limit is not None and self.seconds > self._time_limit:
            raise Stopped(f"the time limit is over: keeping {done} {self._unit}")
        if self._bar is not None:
            self._bar.update(self._task, completed=done)
        elif time.monotonic() - self._said > 5:
            self._said = time.monotonic()
            print(f"{done} of {self._total} {self._unit}, {self.seconds:.0f} s", file=sys.stderr, flush=True)

    def _interrupt(self, *_: object) -> None:
        if self._interrupted:
            raise KeyboardInterrupt
        self._interrupted = True
