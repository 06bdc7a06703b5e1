"""What pages of docs/measured have in common: the head, and Markdown whose lines have at most WIDTH columns."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
import textwrap
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

from solari_vk import __version__
from solari_vk.gpu.device.device import Device

WIDTH = 160


def host_load() -> str:
    """The machine's mean number of running processes over the last minute, "unknown" where the platform has none."""
    return f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown"


def device_facts(device: Device, load: str) -> dict[str, str]:
    """The device, its driver and the host; `load`: `host_load()` before the run."""
    properties = device.properties
    version = ".".join(map(str, properties.api_version))
    return {
        "device": f"{device.name} ({properties.kind}), {properties.uuid}",
        "driver": f"{properties.driver}, Vulkan {version}",
        "rays": f"by {device.rays}",
        "host": f"{os.cpu_count()} cores, load before the run {load}",
        "solari_vk": __version__,
    }


def run_facts() -> dict[str, str]:
    """When, from which commit and by which command a page is written. Of paths only the last part is told."""
    # Paths of the machine that measured are of no use to readers, and are nobody's business.
    words = [os.path.basename(word.rstrip("/")) for word in sys.argv[1:]]
    return {
        "date": datetime.now(UTC).strftime("%Y-%m-%d"),
        "commit": _commit(),
        "command": f"`solari-vk {shlex.join(words)}`",
    }


def _commit() -> str:
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return "unknown, not run from a checkout"
    try:
        command = ["git", "-C", str(root), "describe", "--always", "--dirty"]
        done = subprocess.run(command, capture_output=True, encoding="utf-8", check=False)
    except OSError:
        return "unknown, there is no git"
    return done.stdout.strip() or "unknown"


def head(title: str, intro: Sequence[str], facts: Mapping[str, str]) -> list[str]:
    """The first lines of a page: its title, paragraphs, and a list of when and where it was measured."""
    lines = [f"# {title}"]
    for text in intro:
        lines += ["", *wrapped(text)]
    return [*lines, "", *markdown_list([f"{name}: {value}" for name, value in (run_facts() | dict(facts)).items()])]


def wrapped(text: str, indent: str = "") -> list[str]:
    """The lines of a paragraph, or of an item of a list."""
    return textwrap.wrap(
        text,
        WIDTH,
        initial_indent=indent,
        subsequent_indent=" " * len(indent),
        break_long_words=False,
        break_on_hyphens=False,
    )


def markdown_list(items: Sequence[str]) -> list[str]:
    """The lines of a list."""
    return [line for item in items for line in wrapped(item, "- ")]


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]], numbers: Sequence[int] = ()) -> list[str]:
    """The lines of a table. `numbers`: the columns that are aligned to the right.

    Where a line would be wider than WIDTH, further tables hold the last columns, each with the first column again.
    """
    # The widest first table that fits; its first column names the rows of all tables.
    count = len(head)
    while count > 2 and max(len(_line(row[:count])) for row in (head, *rows)) > WIDTH:
        count -= 1
    rule = ["---:" if column in numbers else "---" for column in range(count)]
    lines = [_line(row[:count]) for row in (head, rule, *rows)]
    if count == len(head):
        return lines
    rest = [[row[0], *row[count:]] for row in (head, *rows)]
    numbers = [number - count + 1 for number in numbers if number >= count]
    return [*lines, "", *markdown_table(rest[0], rest[1:], numbers)]


def _line(row: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |"


def text_table(head: Sequence[str], rows: Sequence[Sequence[str]], numbers: Sequence[int] = ()) -> list[str]:
    """The lines of a table for a terminal, columns aligned."""
    widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
    lines = []
    for row in (head, *rows):
        line = ""
        for column, (cell, width) in enumerate(zip(row, widths, strict=True)):
            line += "  " + (cell.rjust(width) if column in numbers else cell.ljust(width))
        lines.append(line.rstrip())
    return lines
