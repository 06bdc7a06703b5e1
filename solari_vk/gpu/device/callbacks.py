"""What a device calls later: users' callbacks when work is done, and owners of memory when views of it are gone."""

from __future__ import annotations

import threading
import weakref
from collections import deque
from collections.abc import Callable

from solari_vk.base.errors import CallbackError


class Callbacks:
    """Users' callbacks that are due. `add` never calls one; `call` does, between other calls of the device."""

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
        # Taken off the queue first: a callback may add others, or wait, which calls callbacks again.
        due = self._due
        self._due = deque()
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
            # After an exception that isn't an Exception, such as Ctrl-C, the rest is due at the next call.
            self._due.extendleft(reversed(due))
        if errors:
            raise CallbackError(f"callbacks that failed: {', '.join(failed)}; all others were called", errors)


class Loans:
    """Views of the device's memory that others hold, such as tensors. It calls their owners when they are gone, and the
    device's end when the last one is. Any thread may drop the last reference of a view."""

    def __init__(self) -> None:
        self._count = 0
        self._lock = threading.RLock()
        self._end: Callable[[], None] | None = None
        self.returned: deque[Callable[[], None]] = deque()
        """What `collect` is to call, for the views that are gone."""

    def lend(self, view: object, give_back: Callable[[], None]) -> None:
        """Have `give_back` called when `view` is gone, by `collect`."""
        self._count += 1
        weakref.finalize(view, self._return, give_back).atexit = False

    def _return(self, give_back: Callable[[], None]) -> None:
        # The garbage collector may run this in any thread, where nothing of Vulkan may be called.
        self.returned.append(give_back)
        self._end_if_unused()

    def collect(self) -> None:
        """Call what is due. For the thread that uses the device."""
        while self.returned:
            self._count -= 1
            self.returned.popleft()()

    def close(self, end: Callable[[], None]) -> None:
        """Call `end` once, and nothing else from now on: at once, or when the last view is gone."""
        self._end = end
        self._end_if_unused()

    def _end_if_unused(self) -> None:
        with self._lock:
            if self._end is None or len(self.returned) < self._count:
                return
            end = self._end
            self._end = None
        end()
