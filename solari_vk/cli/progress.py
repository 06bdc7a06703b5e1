"""The progress of long commands, and how they end early."""

from __future__ import annotations

import math
import signal
import sys
import time
from typing import Any

from solari_vk.base.errors import SolariError
from solari_vk.gpu.device.compile_notes import CompileNotes

UNLIMITED = 1 << 24  # frames or samples: more than anybody waits for
LINE_SECONDS = 5.0  # between lines where no bar can be shown
NOTEBOOK_LINE_SECONDS = 0.5


class Stopped(Exception):
    """Ctrl-C was pressed or the time limit is over; what is rendered so far counts."""


def error_text(error: float) -> str:
    """The words ", estimated error 2.5 %" or, without an estimate, nothing."""
    return f", estimated error {100 * error:.2g} %" if math.isfinite(error) else ""


def check_time_limit(seconds: float | None) -> None:
    """Raise SolariError for a time limit that is no time."""
    if seconds is not None and not seconds > 0:
        raise SolariError(f"--time-limit {seconds:g}: must be more than 0 seconds")


class Progress:
    """Shows progress: a bar on a terminal, otherwise a line every few seconds. A context manager.

    total: the number of units, None if it isn't known. Call it with the number of units that are done, and the
    picture's estimated error if there is an estimate. The call raises Stopped after Ctrl-C, or `time_limit` seconds
    after the first call: the time before it, in which a driver compiles, doesn't count. A second Ctrl-C ends the
    program. notes: what is compiled meanwhile is shown beside the bar. stops: whether Ctrl-C raises Stopped; without it
    Python raises KeyboardInterrupt as ever. shown: whether anything is shown.
    """

    def __init__(
        self,
        unit: str,
        total: int | None,
        time_limit: float | None = None,
        notes: CompileNotes | None = None,
        *,
        stops: bool = True,
        shown: bool = True,
    ) -> None:
        self._stops = stops
        self._shown = shown
        # A notebook's standard error is no terminal, but a line there can be written again.
        self._in_notebook = "ipykernel" in sys.modules
        self._line_seconds = NOTEBOOK_LINE_SECONDS if self._in_notebook else LINE_SECONDS
        self._unit = unit
        self._total = total
        self._time_limit = time_limit
        self._started = time.monotonic()
        self._last_line = self._started
        self._called = False
        self._interrupted = False
        self._bar: Any = None
        self._notes = notes

    def __enter__(self) -> Progress:
        # Python's own handler would raise KeyboardInterrupt within a frame, whose pictures would be lost.
        if self._stops:
            self._previous_handler = signal.signal(signal.SIGINT, self._interrupt)
        if self._shown and sys.stderr.isatty():
            # On standard error, since standard output may be read by a program.
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

            columns = BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), TextColumn("{task.description}")
            self._bar = Progress(self._unit, *columns, console=Console(stderr=True))
            self._bar.start()
            self._task = self._bar.add_task("", total=self._total)
            if self._notes is not None:
                self._notes.show_by(self._describe)
        return self

    def __exit__(self, *_: object) -> None:
        if self._stops:
            signal.signal(signal.SIGINT, self._previous_handler)
        if self._bar is not None:
            self._bar.stop()
            if self._notes is not None:
                self._notes.show_by(None)

    @property
    def seconds(self) -> float:
        """The seconds since the first call."""
        return time.monotonic() - self._started

    def __call__(self, done: int, error: float = math.inf) -> None:
        if not self._called:
            # What came before it doesn't count, because a driver may compile for a minute.
            self._called = True
            self._started = time.monotonic()
        if self._interrupted:
            raise Stopped(f"interrupted: keeping {done} {self._unit}")
        if self._time_limit is not None and self.seconds > self._time_limit:
            raise Stopped(f"the time limit is over: keeping {done} {self._unit}")
        if self._bar is not None:
            self._bar.update(self._task, completed=done, description=error_text(error))
        elif self._shown and time.monotonic() - self._last_line > self._line_seconds:
            self._last_line = time.monotonic()
            of = "" if self._total is None else f" of {self._total}"
            text = f"{done}{of} {self._unit}, {self.seconds:.0f} s{error_text(error)}"
            print(text, end="\r" if self._in_notebook else "\n", file=sys.stderr, flush=True)

    def _describe(self, text: str) -> None:
        self._bar.update(self._task, description=text)

    def _interrupt(self, *_: object) -> None:
        # The first Ctrl-C waits for the frame to end, so that what is rendered can be written.
        if self._interrupted:
            raise KeyboardInterrupt
        self._interrupted = True
