"""The report of a run: facts about the device and a table of rules, as text, Markdown, HTML or JUnit XML."""

from __future__ import annotations

import html
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from xml.etree import ElementTree

from solari_vk.lab.conformance.outcomes import FAULT, NOT_RUN, RED, STATUSES, UNSUPPORTED, Check, Outcome, Row, rows
from solari_vk.lab.page import head, markdown_list, markdown_table, text_table

_LEGEND = """\
Written by `solari-vk conformance --markdown FILE`. A rule holds when the measured value is at most the bar. Where a
rule is measured in several cases (runs), the table shows the worst. The exit code is 0 when every rule holds. Known
faults (listed with evidence, and with a bound above which they fail too), rules that need a feature which the device
lacks, and rules that only the full profile measures don't change it. Anything else that can't be measured is an error.
A crash, a hang or a lost device ends one check, whose rules before that are in the table; the other checks are measured
in a new process."""
_COLUMNS = ("rule", "document, section", "result", "measured", "bar", "runs")


class Report:
    """What `solari-vk conformance` prints and writes.

    facts: about the device, empty when none could be opened; spent: seconds for each check."""

    def __init__(
        self,
        facts: Mapping[str, str],
        outcomes: Sequence[Outcome],
        full: bool,
        seconds: float,
        spent: Mapping[Check, float] = MappingProxyType({}),
        left_out: Sequence[str] = (),
        interrupted: bool = False,
    ) -> None:
        self._outcomes = outcomes
        self._spent = spent
        self.rows = rows(outcomes)
        self.header = {
            **(facts or {"device": "could not be opened"}),
            "suite": f"{'full' if full else 'fast'} profile, {seconds:.0f} s"
            f" ({sum(os.times()[:4]):.0f} s of processor time)",
            "result": ("interrupted; " if interrupted else "") + self.verdict(),
        }
        # By group, since single checks are many and short.
        seconds_by_group: Counter[str] = Counter()
        for check, value in spent.items():
            seconds_by_group[check.group] += value  # type: ignore[assignment]
        if seconds_by_group:
            self.header["seconds"] = ", ".join(f"{group} {value:.0f}" for group, value in seconds_by_group.items())
        if left_out:
            self.header["left out"] = ", ".join(left_out)

    def verdict(self) -> str:
        """How many rules there are of each status."""
        counts = Counter(row.status for row in self.rows)
        parts = [f"{counts[status]} {status}" for status in reversed(STATUSES) if counts[status]]
        return f"{len(self.rows)} rules: {', '.join(parts) or 'none measured'}"

    def _groups(self) -> dict[str, list[Row]]:
        found: dict[str, list[Row]] = {}
        for row in self.rows:
            found.setdefault(row.group, []).append(row)
        return found

    def _cells(self, row: Row) -> tuple[str, ...]:
        source = ", ".join(part for part in (row.rule.document, row.rule.section) if part)
        return row.rule.name, source, row.status, row.measured, row.bar, str(row.runs)

    def _remarks(self, statuses: Sequence[str]) -> list[str]:
        """The notes of the rows with these statuses; rules of a group that share a note are counted."""
        shared: dict[tuple[str, ...], list[Row]] = {}
        for row in self.rows:
            if row.note and row.status in statuses:
                # One missing feature leaves out many rules: they share a line. Other notes stay with their rule.
                key = (row.group, row.note) if row.status == UNSUPPORTED else (row.group, row.note, row.rule.name)
                shared.setdefault(key, []).append(row)
        lines = []
        for (group, note, *_), members in shared.items():
            rules = members[0].rule.name if len(members) == 1 else f"{len(members)} rules"
            lines.append(f"{group}: {rules}: {note}")
        return lines

    def text(self) -> str:
        """The report as plain text with aligned columns."""
        lines = [f"{name + ':':11}{value}" for name, value in self.header.items()]
        for group, members in self._groups().items():
            lines += ["", group, *text_table(_COLUMNS, [self._cells(row) for row in members])]
        remarks = [f"{status}: {text}" for status in STATUSES for text in self._remarks([status])]
        return "\n".join(lines + (["", *remarks] if remarks else []))

    def markdown(self) -> str:
        """The report as a Markdown page with a table for each group."""
        lines = head("Conformance report", [" ".join(_LEGEND.split())], self.header)
        for group, members in self._groups().items():
            lines += ["", f"## {group}", "", *markdown_table(_COLUMNS, [self._cells(row) for row in members])]
        remarks = {"Failures": RED, "Known faults": (FAULT,), "Unsupported": (UNSUPPORTED,), "Not run": (NOT_RUN,)}
        for title, statuses in remarks.items():
            found = self._remarks(statuses)
            if found:
                lines += ["", f"## {title}", "", *markdown_list(found)]
        return "\n".join(lines) + "\n"

    def html(self) -> str:
        """The report as a self-contained HTML page."""
        parts = [
            "<!doctype html><meta charset='utf-8'><title>Conformance report</title><style>body{font:14px sans-serif;"
            "margin:2em}table{border-collapse:collapse}td,th{border:1px solid #ccc;padding:2px 8px;text-align:left}"
            ".bad{background:#fbb}.fault{background:#fe9}.none{background:#eee}</style><h1>Conformance report</h1><ul>",
            *(f"<li>{html.escape(name)}: {html.escape(value)}" for name, value in self.header.items()),
            "</ul>",
        ]
        colors = {"pass": "", FAULT: "fault", UNSUPPORTED: "none", NOT_RUN: "none"}
        for group, members in self._groups().items():
            parts.append(f"<h2>{html.escape(group)}</h2><table><tr>")
            parts += [f"<th>{name}" for name in (*_COLUMNS, "remark")]
            for row in members:
                cells = "".join(f"<td>{html.escape(cell)}" for cell in (*self._cells(row), row.note))
                parts.append(f"<tr class='{colors.get(row.status, 'bad')}'>{cells}")
            parts.append("</table>")
        return "\n".join(parts) + "\n"

    def junit(self) -> str:
        """The report as JUnit XML: a test case for each case of a group, with its outcomes as properties."""
        cases: dict[tuple[str, str], list[Outcome]] = {}
        for outcome in self._outcomes:
            cases.setdefault((outcome.group, outcome.case), []).append(outcome)
        failed = sum(any(o.status in RED for o in found) for found in cases.values())
        suite = ElementTree.Element("testsuite", name="conformance", tests=str(len(cases)), failures=str(failed))
        for (group, case), found in cases.items():
            seconds = sum(value for check, value in self._spent.items() if check[:2] == (group, case))
            test = ElementTree.SubElement(suite, "testcase", classname=group, name=case, time=f"{seconds:.3f}")
            _fill_test_case(test, found)
        return ElementTree.tostring(suite, encoding="unicode", xml_declaration=True) + "\n"


def _fill_test_case(test: ElementTree.Element, outcomes: Sequence[Outcome]) -> None:
    """Add the outcomes of a case to its element of JUnit: as properties, and as a failure or a reason to skip it."""
    properties = ElementTree.SubElement(test, "properties")
    for outcome in outcomes:
        ElementTree.SubElement(properties, "property", name=outcome.rule.name, value=_figure(outcome))
    red = [row for row in rows(outcomes) if row.status in RED]
    if red:
        lines = [f"{row.rule.name}: {row.note or _figure(row.worst)}" for row in red]
        ElementTree.SubElement(test, "failure", message=lines[0]).text = "\n".join(lines)
    elif all(outcome.measurement is None or outcome.status == FAULT for outcome in outcomes):
        notes = dict.fromkeys(row.note for row in rows(outcomes))
        ElementTree.SubElement(test, "skipped", message="; ".join(notes))


def _figure(outcome: Outcome) -> str:
    made = outcome.measurement
    if made is None:
        return f"{outcome.status}: {outcome.ended or outcome.reason}"
    return f"{outcome.status}: {made.measured:.6g} {made.unit}, bar {made.bar:.6g}"
