"""When the picture is rendered at the window's full size: once nothing has moved for some frames. Needs no window."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable

REST = 6  # frames without a change after which the full size is rendered
FRAMES = 64  # of the full size after which a realtime picture is finished
LEAST_FRAMES = 8  # of the full size after which it is finished if they took longer than PATIENCE
PATIENCE = 30.0  # seconds: on a software device a frame of the full size takes some
SAMPLES = 256  # per pixel after which a path-traced picture is finished
# Full-size pictures begin with a few frames or samples, while the small one before has accumulated many.
HIDDEN = 4  # frames, or samples per pixel, of the full size that look worse than what was shown before
LONGEST_STEP = 0.12  # seconds that a step of a full-size picture should take, so that the window answers
MOST_BANDS = 1 << 20


class Refinement:
    """Whether the picture rests, and how far it has come. Each frame is between `begin_frame` and `end_frame`.

    clock: gives seconds; tests replace it.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self.enabled = True
        self.samples = SAMPLES
        """Samples per pixel after which a path-traced picture is finished; 0: never."""
        self.bands = 1
        """Parts of the picture that a step of the path tracer traces at most."""
        self.done = 0.0
        """The share of the picture's work that is done, from 0 to 1."""
        self.count = 0.0
        """Frames, or samples per pixel, of the full size."""
        self._clock = clock
        self._view: Hashable = None
        self._still = 0
        self._began: tuple[float, float] | None = None  # when `done` was first seen at rest, and what it was

    @property
    def rests(self) -> bool:
        """Whether the picture is rendered at the full size."""
        return self.enabled and self._still > REST

    @property
    def steps(self) -> int:
        """Frames since the full size is rendered."""
        return max(self._still - REST, 0) if self.enabled else 0

    @property
    def frames(self) -> int:
        """Realtime frames since the latest change, or of the full size if the picture rests, as far as more make a
        difference."""
        return min(self.steps or self._still + 1, FRAMES)

    @property
    def moves(self) -> bool:
        """Whether the latest frame differed from the one before."""
        return self._still == 0

    @property
    def begins(self) -> bool:
        """Whether this frame is the first one of the full size."""
        return self.enabled and self._still == REST + 1

    @property
    def finished(self) -> bool:
        """Whether nothing is left to do until something changes."""
        return self.rests and self.done >= 1

    @property
    def hides(self) -> bool:
        """Whether the picture before still looks better than that of the full size."""
        return self.rests and self.count < HIDDEN and not self.finished

    @property
    def seconds_left(self) -> float | None:
        """Until the picture is finished; None while that can't be told."""
        if self._began is None or not self.rests or self.finished:
            return None
        began, done = self._began
        # By the mean rate since the picture began: single steps vary too much.
        gained = self.done - done
        return None if gained <= 0 else (self._clock() - began) * (1 - self.done) / gained

    def shows(self, view: Hashable) -> bool:
        """Whether the latest frame is of this view, and nothing that looks better is shown in its place."""
        return view == self._view and not self.hides

    def begin_frame(self, view: Hashable) -> bool:
        """Compare what the next frame depends on with the last frame; returns whether that changed."""
        # A view is compared as a whole: whatever a picture depends on begins it anew, without a list of events.
        changed = view != self._view
        self._view = view
        # While the picture rests this counts on, for `steps` and `begins`.
        self._still = 0 if changed else self._still + 1
        if changed or self._still <= REST:
            self.done = self.count = 0.0
            self._began = None
        return changed

    def restart(self) -> None:
        """Begin the full size anew after a frame of it was interrupted, because its history is void."""
        self._still = REST
        self.done = 0.0
        self.count = 0.0
        self._began = None

    def end_frame(self, seconds: float, count: float, traced: bool) -> None:
        """Record a frame of the full size that took some seconds. count: frames or samples so far, a part of a sample
        too. traced: whether the path tracer made it."""
        if not self.rests:
            return
        if traced:
            self._adapt_bands(seconds)
        whole = self.samples if traced else FRAMES
        self.count = count
        self.done = min(count / whole, 1.0) if whole else 0.0
        if self._began is None:
            self._began = self._clock(), self.done
        elif not traced and count >= LEAST_FRAMES:
            began, _ = self._began
            self.done = min(max(self.done, (self._clock() - began) / PATIENCE), 1.0)

    def _adapt_bands(self, seconds: float) -> None:
        """Double or halve the bands of a step, so that it takes about LONGEST_STEP."""
        # The limits are more than a factor of two apart: after a change neither of them asks for the opposite one.
        if seconds > 1.5 * LONGEST_STEP:
            self.bands = max(self.bands // 2, 1)
        elif seconds < 0.6 * LONGEST_STEP:
            self.bands = min(2 * self.bands, MOST_BANDS)


def in_words(seconds: float) -> str:
    """A time as 8 s, 1:20 min or 2:05 h."""
    whole = max(round(seconds), 0)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60}:{whole % 60:02} min"
    return f"{whole // 3600}:{whole % 3600 // 60:02} h"
