"""What a viewer tells: news for a while, and what is wrong for as long as it is."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

from solari_vk.errors import SolariError

MESSAGE_SECONDS = 6.0


class Messages:
    """`message` is what is told just now."""

    def __init__(self) -> None:
        self.message = ""
        """What is told in the window; `say` and `warn` set it."""
        self._message_ends = 0.0
        self._faults: dict[str, str] = {}  # what is wrong still, by where: "picture", "panels", "shaders", "file"

    def say(self, text: str) -> None:
        """Tell something in the window for a while."""
        self.message = text
        self._message_ends = time.perf_counter() + MESSAGE_SECONDS
        print(f"solari-vk: {text}", file=sys.stderr)

    def warn(self, text: str) -> None:
        """Tell of something wrong, until something else is told."""
        self.say(text)
        if not self._faults or text in self._faults.values():  # else those come back after a while
            self._message_ends = float("inf")

    @property
    def _fault(self) -> str:
        """What is wrong still, "" when nothing is."""
        return next(iter(self._faults.values()), "")

    def _faulty(self, where: str, error: Exception) -> None:
        if self._faults.get(where) != str(error):
            self._faults[where] = str(error)
            self.warn(str(error))

    def _mended(self, where: str) -> None:
        if self._faults.pop(where, None) == self.message != "":
            self.message = self._fault

    def attempt(self, change: Callable[[], object]) -> None:
        """Change something; what is refused is told."""
        try:
            change()
        except SolariError as error:
            self.warn(str(error))

    def _end_message(self) -> None:
        """After a while, what is wrong still is told again."""
        if self.message and time.perf_counter() > self._message_ends:
            self.message, self._message_ends = self._fault, float("inf")
