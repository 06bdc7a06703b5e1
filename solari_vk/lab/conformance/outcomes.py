"""Rules with their sources, measurements that hold or break them, and the rows of the report that they become."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

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


PASS = "pass"
UNSUPPORTED = "unsupported"
NOT_RUN = "not run (full only)"
FAULT = "known fault"
FAIL = "FAIL"
ERROR = "ERROR"
LOST = "LOST DEVICE"
HANG = "HANG"
CRASH = "CRASH"
# From the worst to the best: a row shows the worst status of its cases.
STATUSES = (CRASH, HANG, LOST, ERROR, FAIL, FAULT, NOT_RUN, UNSUPPORTED, PASS)
RED = (CRASH, HANG, LOST, ERROR, FAIL)  # statuses that make a run fail


class Check(NamedTuple):
    """A case of a group, or one part of the case: what ends when the driver crashes, hangs or loses its device."""

    group: str
    case: str
    part: str = ""

    @property
    def rule(self) -> Rule:
        """The rule that the check reaches its end. The report has it only when it doesn't hold."""
        return Rule(f"{', '.join(filter(None, self[1:]))}: runs to its end", SUITE, "Conformance")


@dataclass(frozen=True)
class Outcome:
    """A measurement, or the reason why there is none, with its group and case.

    ended: how a check ended that didn't reach its end: a signal, a time limit or an error, in a word."""

    group: str
    rule: Rule
    status: str
    case: str = ""
    measurement: Measurement | None = None
    reason: str = ""
    ended: str = ""


@dataclass
class Row:
    """All outcomes of one rule; the report shows the worst."""

    group: str
    rule: Rule
    outcomes: list[Outcome] = field(default_factory=list)

    @property
    def worst(self) -> Outcome:
        """The outcome with the worst status; among several, the one closest to its bar."""
        return min(self.outcomes, key=lambda outcome: (STATUSES.index(outcome.status), -_used(outcome)))

    @property
    def status(self) -> str:
        """The worst status of its cases."""
        return self.worst.status

    @property
    def measured(self) -> str:
        """The worst measured value with its unit, or how the check ended."""
        made = self.worst.measurement
        return f"{made.measured:.3g} {made.unit}" if made else self.worst.ended

    @property
    def bar(self) -> str:
        """The bar of the worst outcome."""
        return f"{self.worst.measurement.bar:.3g}" if self.worst.measurement else ""

    @property
    def note(self) -> str:
        """The reason or the note of the worst outcome, with its case; empty for a rule that simply holds."""
        worst = self.worst
        # Notes of drivers may hold control characters, which XML and terminals do not take.
        told = worst.reason or (worst.measurement.note if worst.measurement and worst.status != PASS else "")
        text = "".join(filter(str.isprintable, " ".join(told.split())))
        return f"{text} [{worst.case}]" if text and worst.case else text

    @property
    def runs(self) -> int:
        """The number of cases in which the rule was measured."""
        return sum(outcome.measurement is not None for outcome in self.outcomes)


def _used(outcome: Outcome) -> float:
    made = outcome.measurement
    if made is None or math.isnan(made.measured):
        return math.inf
    # What is measured by a bar of 0 is a count, of which more is worse.
    return made.measured / made.bar if made.bar else made.measured


def rows(outcomes: Iterable[Outcome]) -> list[Row]:
    """One row for each rule, in the order in which groups and rules first appear."""
    found: dict[tuple[str, Rule], Row] = {}
    for outcome in outcomes:
        key = (outcome.group, outcome.rule)
        found.setdefault(key, Row(*key)).outcomes.append(outcome)
    groups = list(dict.fromkeys(group for group, _ in found))
    return sorted(found.values(), key=lambda row: groups.index(row.group))
