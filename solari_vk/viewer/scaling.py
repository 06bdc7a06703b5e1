"""How many pixels are rendered for a window: a share of its sides, chosen so that a frame takes the time it may."""

from __future__ import annotations

import math
from statistics import median

from solari_vk.errors import SolariError

LEAST = 0.1
STEPS = tuple(round(0.1 * 1.12202**i, 3) for i in range(21))  # 0.1 to 1, each with a quarter more pixels than the last
SETTLE = 3  # frames after a change whose times say nothing: buffers are made, drivers compile
LOOK = 5  # frames from which a time is taken
ROOM = 0.7  # of the time allowed that the next larger size should take at most, or sizes would swing
WORTH = 0.5  # a smaller picture that saves less than this share of what doesn't depend on it isn't worth it


class ScaleControl:
    """The scale of a window: fixed, or "auto" to follow `target`, the seconds a frame may take."""

    def __init__(self, scale: str | float = "auto", target: float = 1 / 30) -> None:
        self.auto = scale == "auto"
        self.target = target
        try:
            self.scale = STEPS[len(STEPS) * 2 // 3] if self.auto else float(scale)
        except (TypeError, ValueError):
            raise SolariError(f"the scale is auto or a number from {LEAST:g} to 1, not {scale!r}") from None
        if not LEAST <= self.scale <= 1:
            raise SolariError(f"the scale is auto or a number from {LEAST:g} to 1, not {scale!r}")
        if not target > 0:
            raise SolariError(f"the time of a frame must be more than 0 seconds, not {target:g}")
        self._times: list[float] = []
        self._known: dict[float, float] = {}  # the latest times at scales
        self._settling = SETTLE

    def unsettle(self) -> None:
        """Something was built anew or changed: what is known of times doesn't count any more."""
        self._known.clear()
        self._settle()

    def _settle(self) -> None:
        self._times.clear()
        self._settling = SETTLE

    def fix(self, scale: float) -> None:
        """Stay at a scale."""
        self.auto, self.scale = False, min(max(scale, LEAST), 1.0)

    def note(self, seconds: float) -> bool:
        """Take up how long a frame took; whether the scale changed by it."""
        if not self.auto:
            return False
        if self._settling:
            self._settling -= 1
            return False
        self._times.append(seconds)
        if len(self._times) < LOOK:
            return False
        time = median(self._times)
        self._times.clear()
        self._known[self.scale] = time
        wanted = self._largest(time)
        at = min(range(len(STEPS)), key=lambda i: abs(STEPS[i] - self.scale))  # it may have been fixed in between
        if wanted < self.scale:
            scale = max((step for step in STEPS if step <= wanted), default=LEAST)
        elif at + 1 < len(STEPS) and STEPS[at + 1] <= wanted * ROOM**0.5:
            scale = STEPS[at + 1]
        else:
            return False
        if scale == self.scale:
            return False
        self.scale = scale
        self._settle()
        return True

    def _largest(self, time: float) -> float:
        """The scale that the time of a frame allows: a part of the time is fixed, and one grows with the pixels."""
        low, high = min(self._known), max(self._known)
        growth = time / self.scale**2
        if low < high:
            growth = max(self._known[high] - self._known[low], 0.0) / (high**2 - low**2)
        growth = max(growth, 1e-9)
        fixed = max(time - growth * self.scale**2, 0.0)
        return math.sqrt(max(self.target - fixed, WORTH * fixed) / growth)

    def size(self, pixels: tuple[int, int]) -> tuple[int, int]:
        """The picture's size for a window of so many pixels."""
        return max(round(pixels[0] * self.scale), 1), max(round(pixels[1] * self.scale), 1)
