"""Rules with their sources, and measurements that hold or break them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

# The documents that most rules are from.
WGPU = "wgpu ray tracing"
VULKAN = "Vulkan 1.3"
SUITE = "solari_vk"


@dataclass(frozen=True)
class Rule:
    """A sentence that must hold, with its source."""

    name: str
    document: str
    section: str


@dataclass(frozen=True)
class Measurement:
    """A measured rule, which holds when `measured` is at most `bar`. `note` says what went wrong and where."""

    rule: Rule
    measured: float
    bar: float = 0.0
    unit: str = "wrong"
    note: str = ""

    @property
    def holds(self) -> bool:
        """Whether `measured` is at most `bar`; false for NaN."""
        return self.measured <= self.bar

    def __str__(self) -> str:
        note = f": {self.note}" if self.note else ""
        return f"{self.rule.name}: {self.measured:.4g} {self.unit}, at most {self.bar:.4g}{note}"


def count_wrong(rule: Rule, wrong: Iterable[str]) -> Measurement:
    """Measure a rule by the number of wrong cases; the note names the first few."""
    names = list(wrong)
    more = f" and {len(names) - 4} more" if len(names) > 4 else ""
    return Measurement(rule, float(len(names)), note=", ".join(names[:4]) + more)
