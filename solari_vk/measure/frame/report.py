"""Tables that are printed as they come and written as a page."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from solari_vk.gpu.device.device import Device
from solari_vk.measure.report import device_facts, host_load, markdown_facts, markdown_table, text_table


class Report:
    """Sections of tables; `path` is written anew with each, so that a run that is stopped leaves what it has."""

    def __init__(self, device: Device, path: Path | None) -> None:
        self._path = path
        self._started = time.perf_counter()
        self._lines = [
            "# The realtime frame in figures", "",
            "Written by `solari-vk bench frame FILES --markdown FILE`. Times of passes are the device's own, medians "
            "of frames; the scene stands still where nothing else is said.", "",
            *markdown_facts(device_facts(device, host_load())),
        ]  # fmt: skip

    def progress(self, text: str) -> None:
        """Say what is being measured."""
        print(f"[{time.perf_counter() - self._started:5.0f} s] {text}", flush=True)

    def table(self, title: str, head: Sequence[str], rows: Sequence[Sequence[str]], *notes: str) -> None:
        """A section: the first column names things, the others are numbers."""
        numbers = range(1, len(head))
        print("\n".join(["", title, *text_table(head, rows, numbers), *(f"  {note}" for note in notes)]), flush=True)
        self._lines += ["", f"## {title}", "", *markdown_table(head, rows, numbers)]
        for note in notes:
            self._lines += ["", note]
        if self._path is not None:
            self._path.write_text("\n".join(self._lines) + "\n", encoding="utf-8")


def ms(value: float) -> str:
    """Milliseconds, to a hundredth where few."""
    return f"{value:.2f}" if value < 10 else f"{value:.1f}" if value < 100 else f"{value:,.0f}"
