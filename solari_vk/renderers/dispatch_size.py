"""How large the path tracer's dispatches are: large enough to be efficient, short enough for drivers' watchdogs."""

from __future__ import annotations

from collections import deque

from solari_vk.gpu.frame.frame import Frame
from solari_vk.passes import reference

MEASURED_DISPATCHES = 4  # whose sizes are remembered until their times are known
FIRST_MEASUREMENT = 4  # frames after which a time is looked at: in the first ones drivers may compile


class DispatchSize:
    """The rows of a picture and the samples per pixel of a dispatch, which change with its time.

    It begins with one sample per pixel. pixel_ms: the milliseconds of a sample of a pixel of an earlier picture, 0 if
    none was measured. frame_count: that of the path tracer's frame.
    """

    def __init__(self, size: tuple[int, int], max_paths: int, frame_count: int = 0, pixel_ms: float = 0.0) -> None:
        self.max_paths = max_paths
        self.rows = reference.max_rows(size, pixel_ms, max_paths)
        self.samples = 1
        self.pixel_ms = pixel_ms
        self.next_measurement = frame_count + FIRST_MEASUREMENT
        """The number of frames from which `adapt` looks at a time."""
        self._width = size[0]
        self._work: deque[tuple[int, int]] = deque(maxlen=MEASURED_DISPATCHES)  # timeline values, samples times rows

    def record(self, timeline_value: int, samples: int, rows: int) -> None:
        """Remember how large the dispatch with a timeline value was."""
        self._work.append((timeline_value, samples * rows))

    def adapt(self, frame: Frame) -> bool:
        """Choose the next dispatches' size by the time that the latest finished one took; whether the rows changed.

        Times are looked at rarely, because on some drivers reading a timestamp waits for work in progress.
        """
        if frame.frame_count < self.next_measurement:
            return False
        self.next_measurement = 2 * frame.frame_count
        milliseconds = sum(frame.timings.values())
        work = dict(self._work).get(frame.timed_value, 0)
        if not milliseconds or not work:
            return False
        # Time is taken to be in proportion to the number of samples, which holds for all but the smallest dispatches.
        wanted_work = reference.DISPATCH_MS / milliseconds * work
        self.pixel_ms = milliseconds / (work * self._width)
        # One measurement may be far off, so that the size grows by a factor of 4 at most.
        most = reference.samples_at_once(self._width, self.rows, self.max_paths)
        self.samples = max(1, min(int(wanted_work / self.rows), 4 * self.samples, most))
        if wanted_work >= self.rows / 4 or self.rows <= reference.MIN_ROWS:
            return False
        # Even one sample per pixel takes more than four times as long as wanted.
        self.rows = max(int(wanted_work), reference.MIN_ROWS)
        return True
