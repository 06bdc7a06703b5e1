"""Tables that are printed as they come and written as a page."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from pathlib import Path

from solari_vk import __version__
from solari_vk.gpu.device.device import Device


class Report:
    """Sections of tables; `path` is written anew with each, so that a run that is stopped leaves what it has."""

    def __init__(self, device: Device, path: Path | None) -> None:
        self._path = path
        self._started = time.perf_counter()
        load = f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown"
        version = ".".join(map(str, device.properties.api_version))
        self._lines = [
            "# The realtime frame in figures", "",
            "Written by `solari-vk bench frame FILES --markdown FILE`. Times of passes are the device's own, medians "
            "of frames; the scene stands still where nothing else is said.", "",
            f"- device: {device.name} ({device.properties.kind}), {os.cpu_count()} cores",
            f"- driver: {device.properties.driver}, Vulkan {version}",
            f"- solari_vk {__version__}", f"- load of the machine before the run: {load}",
        ]  # fmt: skip

    def progress(self, text: str) -> None:
        """Say what is being measured."""
        print(f"[{time.perf_counter() - self._started:5.0f} s] {text}", flush=True)

    def table(self, title: str, head: Sequence[str], rows: Sequence[Sequence[str]], *notes: str) -> None:
        """A section: the first column names things, the others are numbers."""
        print(f"\n{title}")
        widths = [max(len(row[i]) for row in (head, *rows)) for i in range(len(head))]
        for row in (head, *rows):
            cells = [cell.rjust(width) for cell, width in zip(row, widths, strict=True)]
            print("  " + "  ".join([row[0].ljust(widths[0]), *cells[1:]]))
        for note in notes:
            print(f"  {note}")
        print(flush=True)
        self._lines += ["", f"## {title}", "", f"| {' | '.join(head)} |"]
        self._lines.append("| --- |" + " ---: |" * (len(head) - 1))
        self._lines += [f"| {' | '.join(row)} |" for row in rows]
        for note in notes:
            self._lines += ["", note]
        if self._path is not None:
            self._path.write_text("\n".join(self._lines) + "\n", encoding="utf-8")


def ms(value: float) -> str:
    """Milliseconds, to a hundredth where few."""
    return f"{value:.2f}" if value < 10 else f"{value:.1f}" if value < 100 else f"{value:,.0f}"
