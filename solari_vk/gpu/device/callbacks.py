"""Callbacks of users that become due when the device has finished some work. They run only between device calls."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from solari_vk.base.errors import CallbackError


class Callbacks:
    """A queue of callbacks that are due. `add` never calls one; `call` does."""

    def __init__(self) -> None:
        self._due: deque[tuple[str, Callable[[], None]]] = deque()

    def add(self, what: str, callback: Callable[[], None]) -> None:
        """Append a callback; error messages name it by `what`."""
        self._due.append((what, callback))

    def clear(self) -> None:
        """Remove all callbacks without calling them."""
        self._due.clear()

    def call(self) -> None:
        """Call all callbacks that are due now. Callbacks added meanwhile are called by the next `call`.

        A callback that raises an Exception doesn't stop the others; CallbackError with all of these exceptions is
        raised at the end. Other exceptions, such as KeyboardInterrupt, are raised at once.
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
