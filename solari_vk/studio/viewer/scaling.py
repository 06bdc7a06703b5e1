"""Chooses the size of the rendered picture, as a share of the window's, so that frames meet a time limit."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from statistics import median

from solari_vk.base.errors import SolariError, quoted
from solari_vk.settings import FIELDS, Settings

Size = tuple[int, int]
CPU_FPS = 7.0  # frames a second that the scale "auto" aims at on a CPU, where more would be too coarse
MIN_SCALE = 0.1
STEPS = tuple(round(0.1 * 1.12202**i, 3) for i in range(21))  # 0.1 to 1, with a quarter more pixels at each step
IGNORED = 3  # frames after a change whose times are ignored, because buffers are made and drivers compile
LOOK = 5  # frames whose median time is one measurement
ROOM = 0.7  # share of the time limit that the next larger scale may take, so that the scale doesn't oscillate
# A smaller picture saves only the time that grows with the pixels. That time is not pushed below this share of the
# fixed time, because little would be gained.
WORTH = 0.5


class ScaleControl:
    """The scale of the picture: fixed, or "auto" to follow `target`, the seconds that a frame may take."""

    def __init__(self, scale: str | float = "auto", target: float = 1 / 30) -> None:
        self.auto = scale == "auto"
        self.target = target
        try:
            self.scale = STEPS[len(STEPS) * 2 // 3] if self.auto else float(scale)
        except (TypeError, ValueError):
            self.scale = math.nan
        if not MIN_SCALE <= self.scale <= 1:
            raise SolariError(f"the scale is auto or a number from {MIN_SCALE:g} to 1, not {quoted(scale)}")
        self._times: list[float] = []
        self._known: dict[float, float] = {}  # the latest measured time of each scale
        self._ignored = IGNORED

    def forget_times(self) -> None:
        """Forget the measured times, because something that they depend on changed."""
        self._known.clear()
        self._restart()

    def _restart(self) -> None:
        self._times.clear()
        self._ignored = IGNORED

    def fix(self, scale: float) -> None:
        """Use a fixed scale, limited to MIN_SCALE to 1."""
        self.auto = False
        self.scale = min(max(scale, MIN_SCALE), 1.0)

    def record_frame(self, seconds: float) -> bool:
        """Record the time of a frame; returns whether the scale changed."""
        if not self.auto:
            return False
        if self._ignored:
            self._ignored -= 1
            return False
        self._times.append(seconds)
        if len(self._times) < LOOK:
            return False
        time = median(self._times)
        self._times.clear()
        self._known[self.scale] = time
        wanted = self._largest(time)
        # It falls at once to what is wanted and rises by one step at a time, because a slow frame is worse than a
        # coarse one. A scale that was fixed before may lie between two steps.
        at = min(range(len(STEPS)), key=lambda i: abs(STEPS[i] - self.scale))
        if wanted < self.scale:
            scale = max((step for step in STEPS if step <= wanted), default=MIN_SCALE)
        elif at + 1 < len(STEPS) and STEPS[at + 1] <= wanted * ROOM**0.5:
            scale = STEPS[at + 1]
        else:
            return False
        if scale == self.scale:
            return False
        self.scale = scale
        self._restart()
        return True

    def _largest(self, time: float) -> float:
        """The largest scale that `target` allows: part of a frame's time is fixed, the rest grows with the pixels."""
        # With times of two scales the part that grows is known; with one, all of the time counts as growing.
        low, high = min(self._known), max(self._known)
        growth = time / self.scale**2
        if low < high:
            growth = max(self._known[high] - self._known[low], 0.0) / (high**2 - low**2)
        growth = max(growth, 1e-9)
        fixed = max(time - growth * self.scale**2, 0.0)
        return math.sqrt(max(self.target - fixed, WORTH * fixed) / growth)


@dataclass(frozen=True)
class Build:
    """What renderers are made for: sizes of pictures, how much realtime pictures are upscaled, and counting of rays."""

    realtime: Size = (0, 0)
    upscale: float = 1.0
    reference: Size = (0, 0)
    counts_rays: bool = False

    @classmethod
    def of(cls, pixels: Size, scale: float, counts_rays: bool) -> Build:
        """For a window of this width and height of which a share of each is rendered.

        The realtime renderer upscales to the window's size, as far as it can. The path tracer doesn't.
        """
        upscale = min(1 / scale, FIELDS["upscale"].high)
        return cls(_scaled(pixels, scale * upscale), upscale, _scaled(pixels, scale), counts_rays)


class Upscaling:
    """The settings that the realtime renderer has: the user's, but for `upscale`, which follows the scale.

    A value that the user assigns to `upscale` counts until the scale changes. The user's settings stay as they are.
    """

    def __init__(self, user: Settings) -> None:
        self.settings = copy.copy(user)
        self._by_scale = user.upscale  # what the latest scale asked for
        self._seen = user.upscale  # the user's value at the last look
        self._prefers_user = False
        self._followed: tuple[Settings, int, float] | None = None  # what `settings` was copied from

    def factor(self, user: Settings) -> float:
        """The factor in effect: the user's if they have chosen it since the scale changed, else the scale's."""
        if user.upscale != self._seen:
            self.prefer(user)
        return user.upscale if self._prefers_user else self._by_scale

    def prefer(self, user: Settings) -> None:
        """Let the user's value count until the scale changes, also if it is the same as before."""
        self._seen = user.upscale
        self._prefers_user = True

    def follow(self, user: Settings, by_scale: float) -> Settings:
        """`settings`, with the changes that the user has made. by_scale: what the scale asks for."""
        if by_scale != self._by_scale:
            self._by_scale = by_scale
            self._seen = user.upscale
            self._prefers_user = False
        upscale = self.factor(user)
        followed = user, user.revision, upscale
        if followed != self._followed:
            for name in FIELDS:
                value = upscale if name == "upscale" else getattr(user, name)
                if value != getattr(self.settings, name):
                    setattr(self.settings, name, value)
            self._followed = followed
        return self.settings


def _scaled(size: Size, factor: float) -> Size:
    return max(round(size[0] * factor), 1), max(round(size[1] * factor), 1)
