"""What reports have in common: the facts about a device and its host, and tables as text and as Markdown."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from solari_vk import __version__
from solari_vk.files import check_writable, write_whole
from solari_vk.gpu.device.device import Device


def host_load() -> str:
    """The machine's mean number of running processes over the last minute, "unknown" where the platform has none."""
    return f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown"


def device_facts(device: Device, load: str) -> dict[str, str]:
    """The head of a report by name; `load`: `host_load()` before the run."""
    properties = device.properties
    version = ".".join(map(str, properties.api_version))
    return {
        "device": f"{device.name} ({properties.kind}), {properties.uuid}",
        "driver": f"{properties.driver}, Vulkan {version}",
        "rays": f"by {device.rays}",
        "host": f"{os.cpu_count()} cores, load before the run {load}",
        "solari_vk": __version__,
    }


def markdown_facts(facts: Mapping[str, str]) -> list[str]:
    """A list with a line a fact."""
    return [f"- {name}: {value}" for name, value in facts.items()]


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]], numbers: Sequence[int] = ()) -> list[str]:
    """The lines of a table; `numbers`: the indices of the columns that are aligned to the right."""
    rule = ["---:" if column in numbers else "---" for column in range(len(head))]
    return ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in (head, rule, *rows)]


def text_table(head: Sequence[str], rows: Sequence[Sequence[str]], numbers: Sequence[int] = ()) -> list[str]:
    """The same for a terminal, columns aligned."""
    widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
    aligned = [
        [cell.rjust(width) if column in numbers else cell.ljust(width)
         for column, (cell, width) in enumerate(zip(row, widths, strict=True))]
        for row in (head, *rows)
    ]  # fmt: skip
    return ["  " + "  ".join(row).rstrip() for row in aligned]


class Report:
    """Prints tables and single figures as they come, and writes them as a page of Markdown.

    `path` is written again after each of them, so that a run that is stopped leaves what it has. Raises SolariError if
    it can't be written.
    """

    def __init__(self, device: Device, path: Path | None, title: str, intro: Sequence[str]) -> None:
        if path is not None:
            check_writable(path)
        self._path = path
        self._started = time.perf_counter()
        self._lines = [f"# {title}", *(line for text in intro for line in ("", text)), "",
                       *markdown_facts(device_facts(device, host_load()))]  # fmt: skip
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
        self._lines += [line for note in notes for line in ("", note)]
        self._write()

    def _write(self) -> None:
        if self._path is not None:
            figures = ["", *markdown_table(("what", "measured", "remark"), self._figures, (1,))]
            lines = [*self._lines, *(figures if self._figures else ())]
            write_whole(self._path, "\n".join(lines) + "\n")


def milliseconds(value: float) -> str:
    """Milliseconds as text, with more digits for small values."""
    return f"{value:.2f}" if value < 10 else f"{value:.1f}" if value < 100 else f"{value:,.0f}"
