"""The pytest plugin of the suite: one device, measurements turned into outcomes, and the report at the end."""

from __future__ import annotations

import os
import time
import tomllib
from collections.abc import Generator, Iterable, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import pytest

from solari_vk.conformance import report
from solari_vk.conformance.rules import ERROR, FAIL, FAULT, PASS, UNSUPPORTED, Measurement, Outcome, Rule, rows
from solari_vk.gpu.device import Device

FOLDER = Path(__file__).resolve().parent
_RECORDER = pytest.StashKey["Recorder"]()


@dataclass(frozen=True)
class Fault:
    """An entry of known_faults.toml."""

    driver: str
    rule: str
    evidence: str
    case: str = "*"

    def explains(self, rule: Rule, case: str) -> bool:
        """Whether it is about this rule in this case."""
        return fnmatchcase(rule.name, self.rule) and fnmatchcase(case, self.case)


def known_faults(driver: str, file: Path = FOLDER / "known_faults.toml") -> list[Fault]:
    """The faults known of a driver."""
    listed = tomllib.loads(file.read_text(encoding="utf-8")).get("fault", [])
    return [fault for fault in (Fault(**entry) for entry in listed) if fault.driver in driver]


class Recorder:
    """Given to a test as `rule`: takes measurements and turns them into outcomes of its group and case."""

    def __init__(self, group: str, case: str, faults: Sequence[Fault]) -> None:
        self.group, self.case = group, case
        self.outcomes: list[Outcome] = []
        self._faults = faults

    def __call__(self, measured: Measurement | Iterable[Measurement]) -> None:
        """Record one or more measurements."""
        for made in [measured] if isinstance(measured, Measurement) else measured:
            fault = next((fault for fault in self._faults if fault.explains(made.rule, self.case)), None)
            status, reason = (PASS, "") if made.holds else (FAIL, "")
            if fault is not None:
                status, reason = (FAULT, fault.evidence) if not made.holds else (
                    FAIL, "it holds, but is listed in known_faults.toml: remove the entry")  # fmt: skip
            self.outcomes.append(Outcome(self.group, made.rule, status, self.case, made, reason))

    def unsupported(self, rules: Rule | Iterable[Rule], reason: str) -> None:
        """Record that rules can't be measured here, and what is missing."""
        for rule in [rules] if isinstance(rules, Rule) else rules:
            self.outcomes.append(Outcome(self.group, rule, UNSUPPORTED, self.case, None, reason))

    def conclude(self) -> None:
        """End the test as its outcomes say."""
        texts = {
            status: "\n".join(str(o.measurement or o.rule.name) + (f" ({o.reason})" if o.reason else "") for o in found)
            for status in (FAIL, FAULT, UNSUPPORTED)
            if (found := [outcome for outcome in self.outcomes if outcome.status == status])
        }
        if FAIL in texts:
            pytest.fail(texts[FAIL], pytrace=False)
        if FAULT in texts:
            pytest.xfail(texts[FAULT])
        if UNSUPPORTED in texts and all(outcome.status == UNSUPPORTED for outcome in self.outcomes):
            pytest.skip(texts[UNSUPPORTED])


@dataclass(eq=False)
class Suite:
    """A run of the suite: what was asked for, and what came out."""

    select: str | None = None
    full: bool = False
    markdown: Path | None = None
    html: Path | None = None
    outcomes: list[Outcome] = field(default_factory=list)
    faults: list[Fault] = field(default_factory=list)
    started: float = field(default_factory=time.monotonic)
    _device: Device | None = None

    @classmethod
    def from_environment(cls) -> Suite:
        """For plain pytest: SOLARI_VK_CONFORMANCE=full measures more; SOLARI_VK_DEVICE chooses the device."""
        return cls(full=os.environ.get("SOLARI_VK_CONFORMANCE") == "full")

    @property
    def device(self) -> Device:
        """The one device of the run, opened when first asked for. Raises DeviceError when none fits."""
        if self._device is None:
            self._device = Device(self.select)
            self.faults = known_faults(f"{self._device.properties.driver} {self._device.name}")
        return self._device

    def recorder(self, item: Any) -> Recorder:
        """The recorder of a test item."""
        call = getattr(item, "callspec", None)
        group = item.path.stem.removeprefix("test_")
        assert self.device is not None
        return item.stash.setdefault(_RECORDER, Recorder(group, call.id if call else "", self.faults))  # type: ignore[no-any-return]

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Generator[None, None, None]:
        """After a test of the suite: validation messages, then its outcomes."""
        yield
        recorder = item.stash.get(_RECORDER, None)
        if recorder is not None:
            self.device.wait_idle()
            self.device.check_messages()
            recorder.conclude()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(
        self, item: pytest.Item, call: Any
    ) -> Generator[None, pytest.TestReport, pytest.TestReport]:
        """Gather a test's outcomes; one that raised something else than their verdict is an outcome as well."""
        recorder = item.stash.get(_RECORDER, None)
        measured = recorder.outcomes if recorder is not None and call.when == "call" else []
        item.user_properties.extend((outcome.rule.name, _figure(outcome)) for outcome in measured)
        made = yield
        self.outcomes.extend(measured)
        if made.failed and FOLDER in item.path.parents and not any(outcome.status == FAIL for outcome in measured):
            self._note_error(item.path, item.name, made.longreprtext)
        return made

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """A module that can't be imported measured nothing, which must not look like success."""
        if report.failed:
            self._note_error(Path(report.nodeid), report.nodeid, report.longreprtext)

    def _note_error(self, path: Path, name: str, text: str) -> None:
        last = (text.strip().splitlines() or ["failed"])[-1]
        self.outcomes.append(Outcome(path.stem.removeprefix("test_"), Rule(name, "", ""), ERROR, reason=last))

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        """The table, and the files that were asked for."""
        if self._device is None:
            return
        made = report.Report(self._device, rows(self.outcomes), self.full, time.monotonic() - self.started)
        terminalreporter.write_line("")
        for line in made.text().splitlines():
            terminalreporter.write_line(line)
        for file, text in ((self.markdown, made.markdown), (self.html, made.html)):
            if file is not None:
                file.write_text(text(), encoding="utf-8")
                terminalreporter.write_line(f"wrote {file}")

    def pytest_unconfigure(self) -> None:
        """The end of the run."""
        if self._device is not None:
            self._device.close()
            self._device = None


def _figure(outcome: Outcome) -> str:
    made = outcome.measurement
    return f"{outcome.status}: {made.measured:.6g} {made.unit}, bar {made.bar:.6g}" if made else outcome.status
