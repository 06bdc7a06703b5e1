"""The pytest plugin of the suite: one device, measurements turned into outcomes, and the report at the end."""

from __future__ import annotations

import os
import time
import tomllib
from collections import Counter
from collections.abc import Generator, Iterable, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import pytest

from solari_vk.conformance import report
from solari_vk.conformance.groups import GROUPS
from solari_vk.conformance.rules import (
    ERROR,
    FAIL,
    FAULT,
    NOT_RUN,
    PASS,
    RED,
    UNSUPPORTED,
    Measurement,
    Outcome,
    Rule,
    rows,
)
from solari_vk.errors import SolariError
from solari_vk.gpu.device.device import Device
from solari_vk.measure.report import host_load

FOLDER = Path(__file__).resolve().parent
_RECORDER = pytest.StashKey["Recorder"]()


@dataclass(frozen=True)
class Fault:
    """An entry of known_faults.toml."""

    driver: str
    rule: str
    evidence: str
    at_most: float
    case: str = "*"

    def explains(self, rule: Rule, case: str) -> bool:
        """Whether the fault is about this rule in this case."""
        return fnmatchcase(rule.name, self.rule) and fnmatchcase(case, self.case)


def known_faults(driver: str, file: Path = FOLDER / "known_faults.toml") -> list[Fault]:
    """The known faults of a driver. Raises SolariError for an incomplete entry."""
    listed = tomllib.loads(file.read_text(encoding="utf-8")).get("fault", [])
    try:
        return [fault for fault in (Fault(**entry) for entry in listed) if fault.driver in driver]
    except TypeError as error:
        raise SolariError(f"{file.name}: an entry needs driver, rule, evidence and at_most: {error}") from error


class Recorder:
    """The fixture `rule` of a test: turns measurements into outcomes of the test's group and case."""

    def __init__(self, group: str, case: str, faults: Sequence[Fault]) -> None:
        self.group, self.case = group, case
        self.outcomes: list[Outcome] = []
        self._faults = faults

    def __call__(self, measured: Measurement | Iterable[Measurement]) -> None:
        """Record one or more measurements."""
        for made in [measured] if isinstance(measured, Measurement) else measured:
            fault = next((fault for fault in self._faults if fault.explains(made.rule, self.case)), None)
            status, reason = (PASS, "") if made.holds else (FAIL, "")
            if fault is not None and made.holds:
                status, reason = FAIL, "it holds, but is listed in known_faults.toml: remove the entry"
            elif fault is not None and made.measured <= fault.at_most:
                status, reason = FAULT, f"{fault.evidence} Listed up to {fault.at_most:g}."
            elif fault is not None:
                reason = f"known_faults.toml lists it up to {fault.at_most:g} only: it grew worse"
            self.outcomes.append(Outcome(self.group, made.rule, status, self.case, made, reason))

    def unmeasured(self, rules: Rule | Iterable[Rule], status: str, reason: str) -> None:
        """Record why rules aren't measured: UNSUPPORTED by the device, NOT_RUN in this profile, or an ERROR."""
        for rule in [rules] if isinstance(rules, Rule) else rules:
            self.outcomes.append(Outcome(self.group, rule, status, self.case, None, reason))

    def conclude(self) -> None:
        """End the test as its outcomes demand. A test without outcomes fails, since it proves nothing."""
        if not self.outcomes:
            pytest.fail("nothing was measured", pytrace=False)
        if found := self._text(*RED):
            pytest.fail(found, pytrace=False)
        if found := self._text(FAULT):
            pytest.xfail(found)
        if all(outcome.measurement is None for outcome in self.outcomes):
            pytest.skip(self._text(UNSUPPORTED, NOT_RUN))

    def _text(self, *statuses: str) -> str:
        found = [outcome for outcome in self.outcomes if outcome.status in statuses]
        return "\n".join(str(o.measurement or o.rule.name) + (f" ({o.reason})" if o.reason else "") for o in found)


@dataclass(eq=False)
class Suite:
    """A run of the suite: its options and its outcomes."""

    select: str | None = None
    full: bool = False
    only: Sequence[str] = ()
    markdown: Path | None = None
    html: Path | None = None
    outcomes: list[Outcome] = field(default_factory=list)
    faults: list[Fault] = field(default_factory=list)
    spent: dict[str, float] = field(default_factory=dict)  # seconds by group
    started: float = field(default_factory=time.monotonic)
    _deselected: Counter[str] = field(default_factory=Counter)
    _left_out: list[str] = field(default_factory=list)
    _is_part: bool = False  # other tests run in the session: the report is one line
    _device: Device | None = None
    _load: str = field(default_factory=host_load)

    @classmethod
    def from_environment(cls) -> Suite:
        """A suite for plain pytest: SOLARI_VK_CONFORMANCE=full measures more, SOLARI_VK_DEVICE chooses the device."""
        return cls(full=os.environ.get("SOLARI_VK_CONFORMANCE") == "full")

    @property
    def device(self) -> Device:
        """The device of the run, opened at the first use. Raises DeviceError when none fits."""
        return self.open()

    def open(self) -> Device:
        """Open the device if it isn't open yet. Raises DeviceError when none fits."""
        if self._device is None:
            self._device = Device(self.select)
            self.faults = known_faults(f"{self._device.properties.driver} {self._device.name}")
        return self._device

    def recorder(self, item: Any) -> Recorder:
        """The recorder of a test item."""
        self.open()  # so that its known faults are loaded
        made = Recorder(_group(item), item.callspec.params["case"], self.faults)
        return item.stash.setdefault(_RECORDER, made)  # type: ignore[no-any-return]

    def pytest_collection_modifyitems(self, config: pytest.Config, items: list[Any]) -> None:
        """Leave out the groups that weren't asked for."""
        if self.only:
            items[:] = [item for item in items if _group(item) in self.only]

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Generator[None, None, None]:
        """After a test of the suite, check for validation messages, then end it as its outcomes demand."""
        started = time.monotonic()
        yield
        recorder = item.stash.get(_RECORDER, None)
        if recorder is not None:
            self.device.wait_idle()
            self.device.check_messages()
            self.spent[recorder.group] = self.spent.get(recorder.group, 0.0) + time.monotonic() - started
            recorder.conclude()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(
        self, item: pytest.Item, call: Any
    ) -> Generator[None, pytest.TestReport, pytest.TestReport]:
        """Collect a test's outcomes. A test that ends in another error adds an outcome of its own."""
        recorder = item.stash.get(_RECORDER, None)
        measured = recorder.outcomes if recorder is not None and call.when == "call" else []
        item.user_properties.extend((outcome.rule.name, _figure(outcome)) for outcome in measured)
        made = yield
        self.outcomes.extend(measured)
        told = bool(measured) if made.skipped else any(outcome.status in RED for outcome in measured)
        if (made.failed or made.skipped) and _group(item) and not told:
            last = (made.longreprtext.strip().splitlines() or ["failed"])[-1]
            self.outcomes.append(Outcome(_group(item), Rule(item.name, "", ""), ERROR, reason=last))
        return made

    def pytest_deselected(self, items: Sequence[Any]) -> None:
        """Count the checks that an option such as -k left out."""
        self._deselected.update(group for item in items if (group := _group(item)))

    def pytest_collection_finish(self, session: Any) -> None:
        """Note what of the suite isn't run, for the report."""
        run = {_group(item) for item in session.items}
        self._is_part = "" in run
        self._left_out = [f"group {name}" for name in GROUPS if name not in run]
        self._left_out += [f"{count} checks of {name}" for name, count in self._deselected.items() if name in run]

    def pytest_sessionfinish(self, session: Any) -> None:
        """Count a known fault that matches no rule as an error, and let errors decide the exit status."""
        if self._device is not None and not self._left_out:
            for fault in self.faults:
                if not any(fault.explains(outcome.rule, outcome.case) for outcome in self.outcomes):
                    reason = "no rule of that name: remove the entry, or mend it"
                    self.outcomes.append(Outcome("known_faults.toml", Rule(fault.rule, "", ""), ERROR, reason=reason))
        if session.exitstatus == pytest.ExitCode.OK and any(outcome.status in RED for outcome in self.outcomes):
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        """Print the report and write the files that were asked for."""
        if self._device is None:
            return
        seconds = time.monotonic() - self.started
        made = report.Report(
            self._device, rows(self.outcomes), self.full, seconds, self.spent, self._left_out, self._load
        )
        summary = f"conformance: {made.verdict()}" if self._is_part else made.text()
        for line in ["", *summary.splitlines()]:
            terminalreporter.write_line(line)
        for file, text in ((self.markdown, made.markdown), (self.html, made.html)):
            if file is not None:
                file.write_text(text(), encoding="utf-8")
                terminalreporter.write_line(f"wrote {file}")

    def pytest_unconfigure(self) -> None:
        """Close the device."""
        if self._device is not None:
            self._device.close()
            self._device = None


def _group(item: Any) -> str:
    """The group of a test item; empty for a test that isn't the suite's."""
    return item.callspec.params["group"] if item.path.parent == FOLDER else ""


def _figure(outcome: Outcome) -> str:
    made = outcome.measurement
    return f"{outcome.status}: {made.measured:.6g} {made.unit}, bar {made.bar:.6g}" if made else outcome.status
