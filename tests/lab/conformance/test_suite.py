"""Verdicts and reports say what was measured, the command and pytest run the suite, and nothing passes unmeasured."""

from __future__ import annotations

import re
import subprocess
import sys
from xml.etree import ElementTree

import pytest

from solari_vk.base.errors import SolariError
from solari_vk.cli import main
from solari_vk.lab.conformance import embree_checks, groups, run
from solari_vk.lab.conformance.faults import Fault, known_faults, unexplained
from solari_vk.lab.conformance.outcomes import (
    ERROR,
    FAIL,
    FAULT,
    NOT_RUN,
    PASS,
    UNSUPPORTED,
    Check,
    Measurement,
    Outcome,
    Rule,
    rows,
)
from solari_vk.lab.conformance.recorder import Recorder
from solari_vk.lab.conformance.report import Report
from solari_vk.lab.conformance.worker import SuiteOptions

RULE, OTHER = Rule("a rule", "a document", "a section"), Rule("another | rule", "a document", "a section")
GOOD, BAD = Measurement(RULE, 0.5, 1.0, "of it"), Measurement(RULE, 2.0, 1.0, "of it", "here")
LISTED = Fault("llvmpipe", "a r*", "seen with this and that", at_most=3.0)
CHECK = Check("group", "case")


def recorded(record, *faults):
    """The outcomes of a check that records so."""
    outcomes = []
    recorder = Recorder(CHECK, faults, outcomes.append)
    record(recorder)
    recorder.finish()
    return outcomes


def test_statuses():
    worse, no_number = Measurement(RULE, 3.1, 1.0), Measurement(RULE, float("nan"), 1.0)
    for faults, measured, expected, told in (
        ([], GOOD, PASS, ""),
        ([], BAD, FAIL, ""),
        ([], no_number, FAIL, ""),
        ([LISTED], BAD, FAULT, "seen with this and that"),
        ([LISTED], GOOD, FAIL, "known_faults.toml lists this rule as failing, but it holds: remove the entry"),
        ([LISTED], worse, FAIL, "lists this rule as failing up to 3 only"),
        ([LISTED], no_number, FAIL, ""),
    ):
        (outcome,) = recorded(lambda record, made=measured: record(made), *faults)
        assert (outcome.status, outcome.group, outcome.case) == (expected, *CHECK[:2]), (faults, measured)
        assert told in outcome.reason


def test_what_is_not_measured_never_passes():
    (outcome,) = recorded(lambda record: None)
    assert (outcome.status, outcome.reason) == (ERROR, "nothing was measured")
    for status in (UNSUPPORTED, ERROR, NOT_RUN):
        (outcome,) = recorded(lambda record, status=status: record.unmeasured(RULE, status, "the reason"))
        assert (outcome.status, outcome.reason) == (status, "the reason")
        assert rows([outcome, Outcome("group", RULE, PASS, "", GOOD)])[0].status == status


def test_faults_are_listed_whole(tmp_path):
    file = tmp_path / "faults.toml"
    lines = b'[[fault]]\ndriver = "a"\nrule = "b"\nevidence = "c"\n'
    for content, told in (
        (lines, "at_most"),
        (lines + b'at_most = 1\nends = "SIGSEGV"\n', "either"),
        (b"[[fault]]\ndriver = a\n", rf"^{re.escape(str(file))}: .*line 2.*: mend the file, or install"),
        (b"\xff", rf"^{re.escape(str(file))}: .*0xff.*: mend the file, or install"),
    ):
        file.write_bytes(content)
        with pytest.raises(SolariError, match=told):
            known_faults("a driver", file)
    for driver in ("llvmpipe Mesa 25.0", "llvmpipe Mesa 26.2"):
        faults = known_faults(driver)
        assert faults
        assert all((fault.ends or fault.at_most > 0) and len(fault.evidence) > 60 for fault in faults)
    outcomes = [Outcome("group", RULE, FAULT, "case", BAD)]
    assert unexplained([LISTED], outcomes) == []
    (error,) = unexplained([LISTED, Fault("llvmpipe", "a rule", "of another case", 1.0, case="other")], outcomes)
    assert (error.status, error.rule.name) == (ERROR, "a rule")


def test_report_tells_the_worst_case():
    long = Rule("a long one", "a document", "a section")
    outcomes = [
        Outcome("group", RULE, PASS, "one", GOOD),
        Outcome("group", RULE, FAIL, "two", BAD),
        Outcome("group", OTHER, UNSUPPORTED, reason="<feature>"),
        Outcome("late", OTHER, FAULT, "", BAD, "why"),
        Outcome("late", long, NOT_RUN, reason="--full"),
    ]
    made = Report({"device": "a name"}, outcomes, False, 1.0, {CHECK: 1.4}, ["group renderer"])
    assert made.verdict() == "4 rules: 1 unsupported, 1 not run (full only), 1 known fault, 1 FAIL"
    assert made.header["left out"] == "group renderer"
    for text, parts in (
        (made.text(), ("here [two]", "a long one", "2 of it")),
        (made.html(), ("&lt;feature&gt;",)),
        (made.markdown(), ("## Not run", "another \\| rule", "- device: a name", "a document, a section", "why")),
    ):
        assert [part for part in parts if part not in text] == []


def test_command_runs_a_group_and_writes_its_reports(device, tmp_path):
    junit, markdown, html = (tmp_path / f"report.{suffix}" for suffix in ("xml", "md", "html"))
    command = [sys.executable, "-m", "solari_vk", "conformance", "--only", "acceleration_structures"]
    command += ["--junit", junit, "--markdown", markdown, "--html", html]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "TlasInstance.mask keeps its 8 bits" in done.stdout
    page = markdown.read_text()
    assert all(part in page for part in (device.name, device.properties.driver, "- validation: core and"))
    assert "| TlasInstance.mask keeps its 8 bits | wgpu ray tracing" in page
    assert html.read_text().startswith("<!doctype html>")
    properties = ElementTree.parse(junit).getroot().iter("property")
    assert {"pass: 0 wrong, bar 0"} <= {item.get("value") for item in properties}


def test_pytest_runs_the_same(any_device, tmp_path):
    command = [sys.executable, "-m", "pytest", "--pyargs", "solari_vk.lab.conformance", "-v", "-k", "indices"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "test_check[acceleration_structures-indices] PASSED" in done.stdout


def test_missing_embree_is_red(any_device, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "embreex.rtcore_scene", None)
    embree = {name: case for name, case in groups.GROUPS["ray_traversal"].items() if "embree" in name}
    monkeypatch.setattr(groups, "GROUPS", {"ray_traversal": embree, "renderer": groups.GROUPS["renderer"]})
    assert run.run(SuiteOptions(), only=["ray_traversal"], in_process=True) == 1
    printed = capsys.readouterr().out
    for scene in embree_checks.SCENES:
        assert f"ERROR: ray_traversal: {embree_checks.rules(scene)[0].name}: needs embreex" in printed
    assert "left out:  group renderer" in printed


def test_wrong_use_is_told(any_device, tmp_path, capsys, monkeypatch):
    assert main(["conformance", "--only", "nonsense"]) == 2
    assert "ray_queries" in capsys.readouterr().err
    assert main(["conformance", "--html", str(tmp_path / "none" / "report.html")]) == 2
    for limit in ("0", "-1", "nan", "inf", "1000001"):
        assert main(["conformance", f"--time-limit={limit}"]) == 2
        assert "at most 1,000,000 seconds" in capsys.readouterr().err
    for more in ([], ["--in-process"]):
        assert main(["conformance", "--device", "no such device", *more]) == 3
        assert "no such device" in capsys.readouterr().err
        with monkeypatch.context() as patch:
            patch.setenv("SOLARI_VK_RAYS", "nonsense")
            assert main(["conformance", *more]) == 2
        assert "SOLARI_VK_RAYS is 'nonsense'" in capsys.readouterr().err
