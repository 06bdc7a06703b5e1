"""How many pixels are rendered for a window: a share of its sides, chosen so that a frame takes the time it may."""

from __future__ import annotations

from statistics import median

from solari_vk.errors import SolariError

LEAST = 0.1
STEPS = tuple(round(0.1 * 1.12202**i, 3) for i in range(21))  # 0.1 to 1, each with a quarter more pixels than the last
SETTLE = 3  # frames after a change whose times say nothing: buffers are made, drivers compile
LOOK = 5  # frames from which a time is taken
ROOM = 0.7  # of the target that the next larger size should take at most, or sizes would swing


class ScaleControl:
    """The scale of a window: fixed, or "auto" to follow `target`, the seconds a frame may take."""

    def __init__(self, scale: str | float = "auto", target: float = 1 / 30) -> None:
        self.auto = scale == "auto"
        self.target = target
        try:
            self.scale = 0.5 if self.auto else float(scale)
        except (TypeError, ValueError):
            raise SolariError(f"the scale is auto or a number from {LEAST:g} to 1, not {scale!r}") from None
        if not LEAST <= self.scale <= 1:
            raise SolariError(f"the scale is auto or a number from {LEAST:g} to 1, not {scale!r}")
        if not target > 0:
            raise SolariError(f"the time of a frame must be more than 0 seconds, not {target:g}")
        self._times: list[float] = []
        self._settling = SETTLE

    def unsettle(self) -> None:
        """The next frames' times say nothing: something was built anew."""
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
        at = min(range(len(STEPS)), key=lambda i: abs(STEPS[i] - self.scale))  # it may have been fixed in between
        # Time is taken to be a fixed part and one that grows with the pixels; nothing is known of the fixed part but
        # that it makes steps do less than they should, so that steps down may take several looks.
        if time > self.target:
            wanted = self.scale * (self.target / time) ** 0.5
            at = max((i for i, step in enumerate(STEPS[:at]) if step <= wanted), default=0)
        elif at + 1 < len(STEPS) and time * (STEPS[at + 1] / self.scale) ** 2 < ROOM * self.target:
            at += 1
        if STEPS[at] == self.scale:
            return False
        self.scale = STEPS[at]
        self.unsettle()
        return True

    def size(self, pixels: tuple[int, int]) -> tuple[int, int]:
        """The picture's size for a window of so many pixels."""
        return max(round(pixels[0] * self.scale), 1), max(round(pixels[1] * self.scale), 1)
