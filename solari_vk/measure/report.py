"""What reports have in common: the facts about a device and its host, and tables as text and as Markdown."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

from solari_vk import __version__
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
