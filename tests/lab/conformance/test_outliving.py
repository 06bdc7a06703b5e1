"""Crashes, hangs and lost devices are lines of the report, and the rest of the suite goes on."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import pytest

from solari_vk.lab.conformance import run
from solari_vk.lab.conformance.children import Death
from solari_vk.lab.conformance.faults import Fault
from solari_vk.lab.conformance.outcomes import CRASH, FAIL, FAULT, PASS, Check, Measurement, Rule
from solari_vk.lab.conformance.recorder import Recorder
from solari_vk.lab.conformance.results import Results
from solari_vk.lab.conformance.worker import CheckBegan, DeviceOpened, SuiteOptions

LIMIT = 10  # seconds, far more than a check takes that doesn't hang
PROGRAM = """
import sys
from pathlib import Path
from solari_vk.lab.conformance.run import run
from solari_vk.lab.conformance.worker import SuiteOptions
sys.exit(run(SuiteOptions(table="faulty_checks"), only={only}, time_limit={limit}, in_process={in_process},
             markdown=Path("report.md"), html=Path("report.html"), junit=Path("report.xml")))
"""


def start(folder, *only, in_process=False, **variables):
    """The suite with the faulty groups, in a process of its own."""
    program = PROGRAM.format(only=only, limit=LIMIT, in_process=in_process)
    paths = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    return subprocess.Popen(
        [sys.executable, "-c", program],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": paths, **variables},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


@pytest.fixture(scope="module")
def finished(any_device, tmp_path_factory):
    """The folder with the reports of a run, and what the run printed."""
    folder = tmp_path_factory.mktemp("faults")
    process = start(folder, "faults", "after them")
    printed, _ = process.communicate(timeout=600)
    assert process.returncode == 1, printed
    return folder, printed


EXPECTED = {  # by case: the status, how it ended, and what the remark says
    "aborts": ("CRASH", "SIGABRT", "killed by SIGABRT, in <lambda> (", "its last words: driver: out of [31mregisters"),
    "reads address 0": ("CRASH", "SIGSEGV", "killed by SIGSEGV", "measured before: measured before"),
    "sleeps": ("HANG", f"{LIMIT} s", f"killed after {LIMIT} s, in sleep (faulty_checks.py:"),
    "loses the device": ("LOST DEVICE", "VK_ERROR_DEVICE_LOST", "vkQueueSubmit2: VK_ERROR_DEVICE_LOST"),
    "raises": ("ERROR", "", "ZeroDivisionError: division by zero (faulty_checks.py:"),
    "is killed": ("CRASH", "SIGKILL", "as the system does when memory runs out"),
    "closes its pipe": ("CRASH", "exit code 1", "OSError: handle is closed"),
    "leaves": ("CRASH", "exit code 0", "left with exit code 0"),
    "in parts": ("CRASH", "SIGABRT", "measured before"),
    "in parts, second": ("CRASH", "SIGABRT", "measured before"),
    "in parts, third": ("CRASH", "SIGABRT", "measured before"),
    "in vain": ("ERROR", "", "nothing was measured"),
}


def test_an_end_is_a_line_and_the_rest_goes_on(finished):
    """Every check runs once: what it measured before its end is kept, and all that comes later is measured."""
    folder, printed = finished
    page, html = (folder / "report.md").read_text(), (folder / "report.html").read_text()
    for case, (status, ended, *remarks) in EXPECTED.items():
        (row,) = [line for line in page.splitlines() if line.startswith(f"| {case}: runs to")]
        assert f"| {status} | {ended} |" in row
        begin = f"{status}: faults: {case}: runs to its end"
        (remark,) = [line for line in printed.splitlines() if line.startswith(begin)]
        assert all(part in remark for part in remarks), remark
        assert f"{case}: runs to its end" in html
    assert page.count(": runs to its end | ") == len(EXPECTED)
    for name, count in {"measured before": 11 + 2, "measured after": 2}.items():  # of the group `faults`
        row = next(line for line in page.splitlines() if line.startswith(f"| {name} |"))
        assert row.endswith(f" | pass | 0 wrong | 0 | {count} |"), row
    assert "\n## after them\n" in page
    assert "left out: group slow" in page
    for name in ("faults: works", "after them: works", "faults: in parts: first"):
        assert f"{name}: pass (2 results" in printed
    cases = {case.get("name"): case for case in ElementTree.parse(folder / "report.xml").getroot().iter("testcase")}
    assert cases["sleeps"].find("failure").get("message").startswith("sleeps: runs to its end: it was killed after")
    assert float(cases["sleeps"].get("time")) >= LIMIT
    assert cases["works"].find("failure") is None


def test_parts_are_left_out_after_three_losses_of_their_case(monkeypatch, capsys):
    """Two cases that always crash: each is repeated by its parts up to the third loss; the report names the rest."""
    measured = []

    def crash(options, checks, send, limit):
        measured.append(checks[0])
        send(CheckBegan(checks[0]))
        return Death(CRASH, "SIGABRT", "killed", 0.0)

    monkeypatch.setattr(run, "measure_in_child", crash)
    table = SimpleNamespace(GROUPS={"group": {"one": None, "other": None}}, parts=lambda check: [*"pqrst"])
    monkeypatch.setitem(sys.modules, "table", table)
    assert run.run(SuiteOptions(table="table")) == 1
    assert measured == [Check("group", case, part) for case in ("one", "other") for part in ("", "p", "q", "r")]
    left_out = ", ".join(f"group: {case}: {part}" for case in ("one", "other") for part in ("s", "t"))
    assert f"left out:  {left_out}\n" in capsys.readouterr().out


def test_no_device_survives_its_opening(any_device, tmp_path):
    process = start(tmp_path, "faults", "after them", ABORT_AT_OPENING="1")
    printed, _ = process.communicate(timeout=600)
    assert process.returncode == 1, printed
    page = (tmp_path / "report.md").read_text()
    assert "- device: could not be opened" in page
    assert page.count("| opening the device: runs to its end | solari_vk, Conformance | CRASH | SIGABRT |") == 2
    assert "left out: group faults, group after them, group slow" in page


@pytest.mark.parametrize(("sent", "in_process"), [("SIGINT", True), ("SIGTERM", False)])
def test_ctrl_c_ends_the_run_but_not_the_report(any_device, tmp_path, sent, in_process):
    process = start(tmp_path, "slow", in_process=in_process)
    next(line for line in process.stdout if line.startswith("slow: works"))
    time.sleep(1.0)  # for the next check to begin
    os.killpg(process.pid, getattr(signal, sent))
    printed, _ = process.communicate(timeout=60)
    assert process.returncode == 1, printed
    page = (tmp_path / "report.md").read_text()
    assert "- result: interrupted; " in page
    assert "2 checks of slow" in page
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "child").read_text()), 0)


def test_the_report_names_groups_that_trace_in_another_way():
    results = Results({})
    for group, rays in (("a", "query"), ("b", "pipeline"), ("b", "pipeline"), ("c", "query")):
        results.receive(CheckBegan(Check(group, "case")))
        results.receive(DeviceOpened({"rays": f"by {rays}"}, []))
    assert results.facts["rays"] == "by query; b by pipeline"


def test_a_known_crash_is_a_known_fault():
    """One that is gone is red."""
    case = Check("group", "case")
    fault = Fault("llvmpipe", "case: runs to its end", "it crashes when this is sent", ends="SIGSEGV")
    for ended, status, reason in (("SIGSEGV", FAULT, fault.evidence), ("SIGABRT", CRASH, "killed")):
        results = Results({"group": ["case"]})
        results.receive(DeviceOpened({"rays": "by query"}, [fault]))
        results.receive(CheckBegan(case))
        results.died(Death(CRASH, ended, "killed", 1.0))
        (outcome,) = results.outcomes
        assert (outcome.status, outcome.ended, outcome.reason) == (status, ended, reason)
    outcomes = []
    recorder = Recorder(case, [fault], outcomes.append)
    recorder(Measurement(Rule("a rule", "", ""), 0.0))
    recorder.finish()
    assert [outcome.status for outcome in outcomes] == [PASS, FAIL]
    assert "remove the entry" in outcomes[1].reason
