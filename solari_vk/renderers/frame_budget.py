"""Chooses how many paths pixels take, so that frames take the time that the setting frame_ms allows.

A frame's time is that of its paths, which grows with their number, and of its other passes. Both are estimated from the
GPU times of earlier frames, which are known a frame or two later. As times vary, the mean that is aimed at is as far
below the limit as the 95th percentile of frames is above their estimates.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import numpy as np

from solari_vk.base.errors import SolariError
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Frame
from solari_vk.passes.paths import MIN_TIMED_SAMPLES, SHORT_HISTORY, most_timed_samples
from solari_vk.settings import Settings

MIN_SHARE = 1 / 16  # below it the other passes take most of a frame, and histories would hardly grow
MAX_SHARE = float(MIN_TIMED_SAMPLES)  # frames always have the passes for as many paths in each pixel
FRAMES = 64  # whose percentile is taken
FEW_FRAMES = 8  # with fewer of them there is no percentile yet
WEIGHT = 0.2  # of the newest frame in an estimate
JUMP = 1.25  # how much slower than estimated two frames in a row are to be for their time to replace the estimate
PATHS = "paths/"  # what the names of their passes begin with


class FrameBudget:
    """Chooses the `share` for the next frame: the number of its paths over that of a frame without frame_ms. Times are
    in milliseconds."""

    def __init__(self) -> None:
        self.share = 1.0
        """Of the latest frame."""
        self.limit = ""
        """Why frames don't take the time that is asked for. "fewest paths": they take longer, with as few paths as are
        allowed. "most paths": they are done sooner, with as many as are allowed. "denoise=off": each pixel takes a
        path, whatever the time. Empty: they do take that time."""
        self._estimate: tuple[float, float] | None = None  # of the other passes; of all paths at a share of 1
        self._ratios: deque[float] = deque(maxlen=FRAMES)  # of measured times to estimated ones
        self._submitted: dict[int, tuple[float, float]] = {}  # by timeline value: paths, and the estimated time
        self._latest_measurement = 0.0, 0.0  # the latest frame's own estimate
        self._next: tuple[float, float] | None = None  # what was chosen for the next frame
        self._is_first = True
        self._history = 0.0  # frames of light since the latest cut

    @property
    def percentile(self) -> float:
        """The 95th percentile of the latest frames' times over what was expected; 1 if few are known."""
        return float(np.percentile(self._ratios, 95)) if len(self._ratios) >= FEW_FRAMES else 1.0

    def choose_for(self, frame: Frame, settings: Settings, is_cut: bool) -> float:
        """As `choose`, for the next submission of a frame, after a look at the times of those before."""
        times = frame.timings_so_far()
        self.record_times(frame.timed_value, times)
        if not settings.denoise:
            # Only the denoiser can do without a path in a pixel.
            self.share = 1.0
            self.limit = "denoise=off"
            self._next = 1.0, 0.0
            self._history = 0.0
            return self.share
        long = min(SHORT_HISTORY, settings.denoise_max_history - 1)
        return self.choose(settings.frame_ms, settings.paths_short_history_samples, is_cut, long)

    def choose(self, frame_ms: float, short_samples: int, is_cut: bool, long_history: float = SHORT_HISTORY) -> float:
        """The share for the next frame, which is to take frame_ms. short_samples: the paths of pixels with fewer than
        long_history frames, at a share of 1. is_cut: it has no history."""
        self._history = 0.0 if is_cut else self._history
        # After a cut all pixels have a short history, and take more paths at the same share.
        samples = short_samples if self._history < long_history else 1
        max_share = min(MAX_SHARE, most_timed_samples(short_samples) / samples)
        others, paths = self._estimate or (0.0, 0.0)
        if self._estimate is not None:
            # What is left of the time after the other passes, over what all paths take.
            wanted = (frame_ms / max(self.percentile, 1.0) - others) / max(paths * samples, 1e-9)
            self.share = min(max(wanted, MIN_SHARE), max_share)
            self.limit = ""
            if wanted < self.share:
                self.limit = "fewest paths"
            elif wanted > self.share:
                self.limit = "most paths"
        count = max(self.share * samples, 1.0 if self._history < 1.0 else 0.0)  # as in short_history.glsl
        self._next = count, others + paths * count
        self._history += min(count, 1.0)
        return self.share

    def record_submission(self, timeline_value: int) -> None:
        """timeline_value: of a submitted frame. Without a choice for it nothing is recorded. The first one's
        time, which may include what a driver does once, doesn't count."""
        if self._next and not self._is_first:
            self._submitted[timeline_value] = self._next
        self._next = None
        self._is_first = False

    def record_times(self, timeline_value: int, times: Mapping[str, float]) -> None:
        """times: of the passes of the frame with this timeline value, by name. Frames that are known are ignored."""
        # Times are looked at once a frame, and may be those of a frame that is known already.
        if timeline_value not in self._submitted or not times:
            return
        count, expected = self._submitted[timeline_value]
        self._submitted = {later: what for later, what in self._submitted.items() if later > timeline_value}
        # A frame tells two numbers: the time of its other passes, and that of a path in each pixel.
        paths = sum(time for name, time in times.items() if name.startswith(PATHS))
        before, measured = self._latest_measurement, (sum(times.values()) - paths, paths / count)
        self._latest_measurement = measured
        if self._estimate is None:
            self._estimate = measured
            return
        if expected > 0.0:
            self._ratios.append(sum(times.values()) / expected)
        others, all_paths = map(_updated, self._estimate, before, measured)
        self._estimate = others, all_paths


def check_frame_ms(settings: Settings, device: Device) -> None:
    """Raise SolariError if frames with these settings can't follow frame_ms."""
    if settings.frame_ms == 0.0:
        return
    if settings.lighting != "paths" or settings.restir:
        raise SolariError("Renderer: the setting frame_ms needs lighting=paths and restir=off")
    if not device.timestamp_bits:
        raise SolariError(f"Renderer: {device.name} has no timestamps, which the setting frame_ms needs: set it to 0")


def _updated(estimate: float, before: float, measured: float) -> float:
    """An estimate, after two frames. One slow frame alone, as other programs cause, changes it little."""
    # A lasting change shows in two frames in a row, and replaces the estimate; else it is an exponential mean, to which
    # a slow frame counts as JUMP times the estimate at most.
    at_once = min(before, measured)
    return at_once if at_once > JUMP * estimate else estimate + WEIGHT * (min(measured, JUMP * estimate) - estimate)
