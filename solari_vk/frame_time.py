"""Chooses how many paths pixels take, so that frames take the time that the setting frame_ms allows.

A frame's time is that of its paths, which grows with their number, and of its other passes. Both are estimated from the
GPU times of earlier frames, which are known a frame or two later. As times vary, the mean that is aimed at is as far
below the limit as the 95th percentile of frames is above their estimates.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import numpy as np

from solari_vk.errors import SolariError
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Frame
from solari_vk.settings import Settings

MIN_SHARE = 1 / 16  # below it the other passes take most of a frame, and histories would hardly grow
MAX_SHARE = 2.0
LONG_HISTORY = 8.0  # frames: SHORT_HISTORY of glsl/passes/paths/short_history.glsl
FRAMES = 64  # whose percentile is taken
FEW_FRAMES = 8  # with fewer of them there is no percentile yet
WEIGHT = 0.2  # of the newest frame in an estimate
JUMP = 1.25  # how much slower than estimated a frame is to be for its time to replace the estimate
PATHS = "paths/"  # what the names of their passes begin with


class FrameTimeControl:
    """The share of paths for the next frame, over as many as without frame_ms. Times are in milliseconds."""

    def __init__(self) -> None:
        self.share = 1.0
        """Of the latest frame."""
        self.limit = ""
        """What keeps frames from taking the time that is asked for: "fewest paths", so that they take longer, or "most
        paths", so that they are done sooner; empty if nothing does."""
        self._estimate: tuple[float, float] | None = None  # of the other passes; of all paths at a share of 1
        self._ratios: deque[float] = deque(maxlen=FRAMES)  # of measured times to estimated ones
        self._submitted: dict[int, tuple[float, float]] = {}  # by timeline value: paths, and the estimated time
        self._next: tuple[float, float] | None = None  # what was chosen for the next frame
        self._history = 0.0  # frames of light since the latest cut

    @property
    def percentile(self) -> float:
        """The 95th percentile of the latest frames' times over what was expected; 1 if few are known."""
        return float(np.percentile(self._ratios, 95)) if len(self._ratios) >= FEW_FRAMES else 1.0

    def choose_for(self, frame: Frame, settings: Settings, is_cut: bool) -> float:
        """As `choose`, for the next submission of a frame, after a look at the times of those before."""
        times = frame.timings_so_far()
        self.note_times(frame.timed_value, times)
        return self.choose(settings.frame_ms, settings.paths_short_history_samples, is_cut)

    def choose(self, frame_ms: float, short_history_samples: int, is_cut: bool) -> float:
        """The share for the next frame, which is to take frame_ms. is_cut: it has no history."""
        self._history = 0.0 if is_cut else self._history
        samples = short_history_samples if self._history < LONG_HISTORY else 1
        self._next = 1.0, 0.0
        if self._estimate is not None:
            others, paths = self._estimate
            wanted = (frame_ms / max(self.percentile, 1.0) - others) / max(paths * samples, 1e-9)
            self.share = min(max(wanted, MIN_SHARE), MAX_SHARE)
            self.limit = "fewest paths" if wanted < self.share else "most paths" if wanted > self.share else ""
            self._next = self.share * samples, others + paths * self.share * samples
        self._history += min(self.share * samples, 1.0)
        return self.share

    def note_submission(self, value: int) -> None:
        """value: the device's timeline value of the frame that was chosen for; nothing is kept of others."""
        if self._next is not None:
            self._submitted[value], self._next = self._next, None

    def note_times(self, value: int, times: Mapping[str, float]) -> None:
        """times: of the passes of the frame with this timeline value, by name. Frames that are known are ignored."""
        if value not in self._submitted or not times:
            return
        count, expected = self._submitted[value]
        self._submitted = {later: what for later, what in self._submitted.items() if later > value}
        paths = sum(time for name, time in times.items() if name.startswith(PATHS))
        found = sum(times.values()) - paths, paths / count
        if self._estimate is None:
            self._estimate = found
            return
        if expected > 0.0:
            self._ratios.append(sum(times.values()) / expected)
        self._estimate = _updated(self._estimate[0], found[0]), _updated(self._estimate[1], found[1])


def check_frame_ms(settings: Settings, device: Device) -> None:
    """Raise SolariError if frames with these settings can't follow frame_ms."""
    if settings.frame_ms == 0.0:
        return
    if settings.lighting != "paths" or settings.restir:
        raise SolariError("Renderer: the setting frame_ms needs lighting=paths and restir=off")
    if not device.timestamp_bits:
        raise SolariError(f"Renderer: {device.name} has no timestamps, which the setting frame_ms needs: set it to 0")


def _updated(estimate: float, found: float) -> float:
    return found if found > JUMP * estimate else estimate + WEIGHT * (found - estimate)
