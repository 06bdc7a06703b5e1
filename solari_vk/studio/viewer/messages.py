"""Messages to the user of a viewer: notes for a few seconds, and faults until they are corrected."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from solari_vk.base.errors import DeviceError, SolariError, ValidationError

MESSAGE_SECONDS = 6.0


class Messages:
    """`message` is the text that the window shows now, "" for none."""

    def __init__(self) -> None:
        self.message = ""
        self.faults: dict[str, str] = {}
        """The text of each fault that is not corrected yet, by its place: "picture", "panels", "shaders" or "file"."""
        self._message_ends = 0.0

    def say(self, text: str) -> None:
        """Show a text for a few seconds, and print it to stderr."""
        self.message = text
        self._message_ends = time.perf_counter() + MESSAGE_SECONDS
        print(f"solari-vk: {text}", file=sys.stderr)

    def warn(self, text: str) -> None:
        """Show a text until another one is shown."""
        self.say(text)
        # A fault stays until it is corrected, a mistake until something else is said.
        if not self.faults or text in self.faults.values():  # else the faults are shown again after a while
            self._message_ends = float("inf")

    def report(self, place: str, error: Exception) -> None:
        """Show a fault until `clear_fault`; a fault that was reported before is not shown again."""
        # A fault is found again in each frame, and said once.
        if self.faults.get(place) != str(error):
            self.faults[place] = str(error)
            self.warn(str(error))

    def clear_fault(self, place: str) -> None:
        """Forget the fault of a place, which is corrected."""
        if self.faults.pop(place, None) == self.message != "":
            self.message = next(iter(self.faults.values()), "")

    @contextmanager
    def showing_mistakes(self, place: str = "") -> Iterator[None]:
        """Show a user's mistake instead of raising it: as the fault of a place, or else until the next message."""
        try:
            yield
        # A lost device ends the viewer, and the validation layer's errors are those of the package, not of the user.
        except (DeviceError, ValidationError):
            raise
        except (SolariError, OSError) as error:
            if place:
                self.report(place, error)
            else:
                self.warn(str(error))

    def end_message(self) -> None:
        """If a message's time is over, show a fault that is not corrected yet, or nothing."""
        if self.message and time.perf_counter() > self._message_ends:
            self.message = next(iter(self.faults.values()), "")
            self._message_ends = float("inf")
