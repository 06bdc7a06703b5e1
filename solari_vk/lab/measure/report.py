"""The report of a measurement: printed as it comes, and written as a page of docs/measured."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from solari_vk.base.files import check_writable, followed, write_whole
from solari_vk.gpu.device.device import Device
from solari_vk.lab.page import device_facts, head, host_load, markdown_table, text_table, wrapped


class Report:
    """Prints tables and single figures as they come, and writes them as a page of Markdown.

    `path` is written again after each of them, so that a run that is stopped leaves what it has. Raises SolariError if
    it can't be written. facts: about the run, in place of the device's of the same name, such as "rays".
    """

    def __init__(self, device: Device, path: Path | None, title: str, intro: Sequence[str], **facts: str) -> None:
        if path is not None:
            check_writable(path)
        self._path = path
        self._started = time.perf_counter()
        # The load of the machine is taken before the measurement adds to it.
        self._lines = head(title, intro, device_facts(device, host_load()) | facts)
        self._figures: list[tuple[str, str, str]] = []

    def progress(self, text: str) -> None:
        """Print what is measured next."""
        print(f"[{time.perf_counter() - self._started:5.0f} s] {text}", flush=True)

    def figure(self, what: str, value: float, unit: str, note: str = "") -> None:
        """Add a row to the page's table of single figures."""
        text = f"{value:,.0f}" if unit == "bytes" else f"{value:,.3f}"
        print(f"{what:<60} {text:>14} {unit}" + (f"  ({note})" if note else ""), flush=True)
        self._figures.append((what, f"{text} {unit}".rstrip(), note))
        self._write()

    def table(self, title: str, head: Sequence[str], rows: Sequence[Sequence[str]], *notes: str) -> None:
        """Add a section with a table whose first column is text and whose other columns are numbers."""
        numbers = range(1, len(head))
        print("\n".join(["", title, *text_table(head, rows, numbers), *(f"  {note}" for note in notes)]), flush=True)
        self._lines += ["", f"## {title}", "", *markdown_table(head, rows, numbers)]
        self._lines += [line for note in notes for line in ("", *wrapped(note))]
        self._write()

    def _write(self) -> None:
        if self._path is not None:
            figures = ["", *markdown_table(("what", "measured", "remark"), self._figures, (1,))]
            lines = [*self._lines, *(figures if self._figures else ())]
            write_whole(followed(self._path), "\n".join(lines) + "\n")


@contextmanager
def measuring(
    select: str | None, rays: str | None, path: Path | None, title: str, *intro: str
) -> Iterator[tuple[Device, Report]]:
    """The device and the report of a measurement. `select` and `rays`: those of `Device`. path: a page to write.

    Raises SolariError where the page can't be written.
    """
    with Device(select, rays=rays) as device:
        yield device, Report(device, path, title, intro)
    if path is not None:
        print(f"wrote {path}")


def milliseconds(value: float) -> str:
    """Milliseconds as text, with more digits for small values."""
    if value < 10:
        return f"{value:.2f}"
    return f"{value:.1f}" if value < 100 else f"{value:,.0f}"
