"""Says what is being compiled, which takes a software device up to minutes when it first renders."""

from __future__ import annotations

import shutil
import sys
import threading
import time
from collections.abc import Callable

from solari_vk.gpu.device.compiling import Compiling

PATIENCE = 3.0  # seconds: what takes less isn't mentioned
PAUSE = 5.0  # seconds between two lines where stderr is no terminal


class CompileNotes:
    """A device's `on_compile` that names on stderr what takes long: in a line that changes on a terminal, otherwise in
    a line every few seconds. patience: seconds for which nothing is said (3).
    """

    def __init__(self, patience: float | None = None) -> None:
        self.patience = PATIENCE if patience is None else patience
        self.seconds = 0.0
        """How long compilations have taken."""
        self.show_by(None)
        self._lock = threading.Lock()
        self._waiting: threading.Timer | None = None
        self._state: Compiling | None = None
        self._shown = False
        self._printed = -PAUSE

    def show_by(self, show: Callable[[str], object] | None) -> None:
        """Call `show`, in place of writing to stderr, with the words, and with "" when they are out of date."""
        terminal = sys.stderr is not None and sys.stderr.isatty()  # None: the process has none
        self._show = show or (_show_in_place if terminal else self._print_sometimes)

    @property
    def after(self) -> str:
        """The words " after compiling for 9.1 s", or nothing if that was quick."""
        return f" after compiling for {self.seconds:.1f} s" if self.seconds >= self.patience else ""

    def __call__(self, state: Compiling) -> None:
        now = time.monotonic()
        if state.done == 0:
            self._began = now
        if state.done == state.total:
            self.seconds += now - self._began
        with self._lock:
            self._state = state if state.done < state.total else None
            if self._state is None and self._waiting is not None:
                self._waiting.cancel()
                self._waiting = None
            if self._shown:
                self._show("" if self._state is None else str(state))
                self._shown = self._state is not None
            elif self._state is not None and self._waiting is None:
                self._waiting = threading.Timer(self.patience, self._lose_patience)
                self._waiting.daemon = True
                self._waiting.start()

    def _lose_patience(self) -> None:
        with self._lock:
            if self._state is not None:
                self._show(str(self._state))
                self._shown = True

    def _print_sometimes(self, text: str) -> None:
        if text and time.monotonic() - self._printed >= PAUSE:
            self._printed = time.monotonic()
            print(text, file=sys.stderr, flush=True)


def _show_in_place(text: str) -> None:
    """Replace the line where the cursor is."""
    width = shutil.get_terminal_size().columns - 1
    shown = text[:width]
    # With spaces over the rest of what was there: older consoles of Windows know no codes for it.
    print(f"\r{shown:<{width}}\r{shown}", end="", file=sys.stderr, flush=True)
