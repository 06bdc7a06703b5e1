"""Functions that users have called when the device has come so far: between its calls, never within one."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from solari_vk.errors import CallbackError


class Callbacks:
    """What is due to be called. Adding one never calls it; `call` does."""

    def __init__(self) -> None:
        self._due: deque[tuple[str, Callable[[], None]]] = deque()

    def add(self, what: str, callback: Callable[[], None]) -> None:
        """Have it called next time; `what` is what messages call it."""
        self._due.append((what, callback))

    def clear(self) -> None:
        """Forget what is due."""
        self._due.clear()

    def call(self) -> None:
        """Call each that is due now, whatever others do; those that become due meanwhile are left for the next time.

        Raises CallbackError with what they raised. What isn't an error, such as KeyboardInterrupt, comes out at once.
        """
        due, self._due = self._due, deque()
        failed: list[str] = []
        errors: list[Exception] = []
        try:
            while due:
                what, callback = due.popleft()
                try:
                    callback()
                except Exception as error:
                    error.add_note(f"raised by the callback of {what}")
                    failed.append(what)
                    errors.append(error)
        finally:
            self._due.extendleft(reversed(due))
        if errors:
            raise CallbackError(f"callbacks that failed: {', '.join(failed)}; all others were called", errors)
