"""Views of a device's memory that others hold, such as tensors."""

from __future__ import annotations

import threading
import weakref
from collections import deque
from collections.abc import Callable


class Lent:
    """Knows which views are left. Any thread may drop the last reference of one."""

    def __init__(self) -> None:
        self._count = 0
        self._lock = threading.RLock()
        self._end: Callable[[], None] | None = None
        self.returned: deque[Callable[[], None]] = deque()
        """What is to be called for the views that are gone."""

    def lend(self, memory: object, give_back: Callable[[], None]) -> None:
        """Have `give_back` called when `memory` is gone, by `collect`."""
        self._count += 1
        weakref.finalize(memory, self._take_back, give_back).atexit = False

    def _take_back(self, give_back: Callable[[], None]) -> None:
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
            end, self._end = self._end, None
        end()
