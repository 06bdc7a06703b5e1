"""How large the frames are that a page is sent: by their round trip, from sending to the page's answer.

As TCP Vegas does (Brakmo and Peterson, 1995), the shortest round trip so far stands for the empty line, and what is
beyond it for frames that wait in queues.
"""

from __future__ import annotations

import math

# The share of the picture's width and height, and the quality of the JPEG. Each level has up to twice the bytes of the
# one before.
LEVELS = ((0.25, 40), (0.35, 50), (0.5, 60), (0.75, 70), (1.0, 75), (1.0, 85), (1.0, 92))
IN_FLIGHT = 2  # frames that are sent and not yet answered: while one travels, the next is rendered
LONG_DELAY = 0.15  # seconds of queueing that make the frames smaller
SHORT_DELAY = 0.05  # seconds of queueing below which frames become larger
STEADY = 3  # frames of a short delay before that
FORGET = 0.002  # seconds by which each frame raises the shortest round trip: the line may have become longer
LOSSLESS_RATE = 2e6  # bytes a second from which the last picture of a still camera is sent without loss


class Pace:
    """The level of a page's frames, and the times from which it follows.

    The first frame is of the smallest level: it measures the round trip, and is there soon. Times are in seconds, of
    any clock.
    """

    def __init__(self) -> None:
        self.level = 0
        self.rate = 0.0
        """Bytes a second that the last frame reached at least."""
        self._sent: dict[int, tuple[float, int, int]] = {}
        self._shortest = float("inf")
        self._steady = 0
        self._answered = -math.inf  # when the last frame was

    @property
    def ready(self) -> bool:
        """Whether the page may be sent another frame."""
        return len(self._sent) < IN_FLIGHT

    def sent(self, number: int, length: int, now: float) -> None:
        """Record that a frame of this many bytes is sent."""
        self._sent[number] = now, length, self.level

    def shown(self, number: int, now: float) -> None:
        """Record that the page has shown a frame, which was sent unless the page lies."""
        if number not in self._sent:
            return
        began, length, level = self._sent.pop(number)
        for earlier in [other for other in self._sent if other < number]:
            del self._sent[earlier]  # a page that was hidden tells of the last one alone
        # The page's decoding is a part of the round trip.
        seconds = max(now - began, 1e-4)
        # A frame that follows another one on the line waits for it.
        self.rate = length / max(now - max(began, self._answered), 1e-4)
        self._answered = now
        self._shortest = min(seconds, self._shortest + FORGET)
        if level != self.level:
            return  # it was sent before the level changed
        delay = seconds - self._shortest
        self._steady = self._steady + 1 if delay < SHORT_DELAY else 0
        if delay > LONG_DELAY:
            self.level = max(level - 1, 0)
            self._steady = 0
        elif self._steady >= STEADY:
            self.level = min(level + 1, len(LEVELS) - 1)
            self._steady = 0
