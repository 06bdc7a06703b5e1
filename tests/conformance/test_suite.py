"""Verdicts and reports say what was measured, the command and pytest run the suite, and nothing passes unmeasured."""

from __future__ import annotations

import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import pytest

from solari_vk.cli import main
from solari_vk.conformance import embree_checks
from solari_vk.conformance.report import Report
from solari_vk.conformance.rules import ERROR, NOT_RUN, UNSUPPORTED, Measurement, Outcome, Rule, rows
from solari_vk.conformance.suite import Fault, Recorder, known_faults
from solari_vk.errors import SolariError

RULE, OTHER = Rule("a rule", "a document", "a section"), Rule("another | rule", "a document", "a section")
GOOD, BAD = Measurement(RULE, 0.5, 1.0, "of it"), Measurement(RULE, 2.0, 1.0, "of it", "here")
FAULT = Fault("llvmpipe", "a r*", "seen with this and that", at_most=3.0)


def verdict(recorder):
    """What `conclude` raises: its type's name and its text."""
    try:
        recorder.conclude()
    except (pytest.fail.Exception, pytest.skip.Exception, pytest.xfail.Exception) as raised:
        return type(raised).__name__, str(raised)
    return "pass", ""


def test_verdicts():
    for faults, measured, expected in (
        ([], GOOD, "pass"), ([], BAD, "Failed"), ([FAULT], BAD, "XFailed"), ([FAULT], GOOD, "Failed"),
        ([], Measurement(RULE, float("nan"), 1.0), "Failed"), ([FAULT], Measurement(RULE, 3.1, 1.0), "Failed"),
        ([FAULT], Measurement(RULE, float("nan"), 1.0), "Failed"),
    ):  # fmt: skip
        recorder = Recorder("group", "case", faults)
        recorder(measured)
        assert verdict(recorder)[0] == expected, (faults, measured)
    grown = Recorder("group", "case", [FAULT])
    grown(Measurement(RULE, 3.1, 1.0))
    assert "up to 3 only" in verdict(grown)[1]


def test_what_is_not_measured_never_passes():
    assert verdict(Recorder("group", "", [])) == ("Failed", "nothing was measured")
    for status, expected in ((UNSUPPORTED, "Skipped"), (ERROR, "Failed"), (NOT_RUN, "Skipped")):
        recorder = Recorder("group", "", [])
        recorder.unmeasured(RULE, status, "the reason")
        assert verdict(recorder) == (expected, "a rule (the reason)")
        assert rows(recorder.outcomes)[0].status != "pass"
        recorder(BAD)
        assert verdict(recorder)[0] == "Failed"


def test_faults_are_listed_whole(tmp_path):
    file = tmp_path / "faults.toml"
    file.write_text('[[fault]]\ndriver = "a"\nrule = "b"\nevidence = "c"\n')
    with pytest.raises(SolariError, match="at_most"):
        known_faults("a driver", file)
    for driver in ("llvmpipe Mesa 25.0", "llvmpipe Mesa 26.2"):
        faults = known_faults(driver)
        assert faults
        assert all(fault.at_most > 0 and len(fault.evidence) > 60 for fault in faults)


def test_report_tells_the_worst_case(device):
    outcomes = [
        Outcome("group", RULE, "pass", "one", GOOD), Outcome("group", RULE, "FAIL", "two", BAD),
        Outcome("group", OTHER, "unsupported", reason="<feature>"),
        Outcome("late", OTHER, "known fault", "", BAD, "why"),
    ]  # fmt: skip
    outcomes.append(Outcome("late", Rule("a long one", "a document", "a section"), NOT_RUN, reason="--full"))
    made = Report(device, rows(outcomes), False, 1.0, {"group": 1.4}, ["group brdf"])
    assert made.verdict() == "4 rules: 1 unsupported, 1 not run (full only), 1 known fault, 1 FAIL"
    assert made.header["left out"] == "group brdf"
    text, page, markdown = made.text(), made.html(), made.markdown()
    assert "here [two]" in text
    assert "a long one" in text
    assert "## Not run" in markdown
    assert "2 of it" in text
    assert "&lt;feature&gt;" in page
    assert "another \\| rule" in markdown
    assert all(part in markdown for part in (device.name, device.properties.driver, "a document, a section", "why"))


def test_command_runs_a_group_and_writes_its_reports(any_device, tmp_path):
    junit, markdown, html = (tmp_path / f"report.{suffix}" for suffix in ("xml", "md", "html"))
    command = [sys.executable, "-m", "solari_vk", "conformance", "--only", "acceleration_structures"]
    command += ["--junit", junit, "--markdown", markdown, "--html", html]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "TlasInstance.mask keeps its 8 bits" in done.stdout
    assert "| TlasInstance.mask keeps its 8 bits | wgpu ray tracing" in markdown.read_text()
    assert html.read_text().startswith("<!doctype html>")
    properties = ElementTree.parse(junit).getroot().iter("property")
    assert {"pass: 0 wrong, bar 0"} <= {item.get("value") for item in properties}


def test_pytest_runs_the_same(any_device, tmp_path):
    command = [sys.executable, "-m", "pytest", "--pyargs", "solari_vk.conformance", "-k", "indices"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "TlasInstance.custom_data keeps its 24 bits" in done.stdout


def run_suite(folder, preparation, *options):
    """A Python process that prepares `groups` and `made`, a Suite, and runs the suite with pytest."""
    program = f"""
import pytest, sys
sys.modules["embreex"] = None
from solari_vk.conformance import groups, suite
from solari_vk.conformance.rules import Measurement, Rule
made = suite.Suite()
made.open()
made.faults = []
{preparation}
options = ["-p", "no:cacheprovider", "--pyargs", "solari_vk.conformance", *{options}]
sys.exit(pytest.main(options, plugins=[made]))
"""
    return subprocess.run([sys.executable, "-c", program], cwd=folder, capture_output=True, text=True, check=False)


def test_missing_embree_is_red(any_device, tmp_path):
    done = run_suite(tmp_path, "", "-k", "embree")
    assert done.returncode == 1, done.stdout + done.stderr
    for scene in embree_checks.SCENES:
        assert f"ERROR: ray_queries: {embree_checks.rules(scene)[0].name}: needs embreex" in done.stdout
    (left_out,) = [line for line in done.stdout.splitlines() if line.startswith("left out:")]
    assert "checks of ray_queries" in left_out


UNMEASURED = {
    "nothing measured": ("[]", "nothing was measured"),
    "skipped": ("pytest.skip('no time')", "no time"),
    "broken": ("1 / 0", "ZeroDivisionError"),
}


@pytest.mark.parametrize("name", UNMEASURED)
def test_groups_that_measure_nothing_are_red(any_device, tmp_path, name):
    measured, expected = UNMEASURED[name]
    done = run_suite(tmp_path, f"groups.GROUPS = {{'made_up': {{'it': lambda run: {measured}}}}}")
    assert done.returncode not in (0, 3), done.stdout + done.stderr
    (line,) = [line for line in done.stdout.splitlines() if line.startswith("ERROR: made_up: ")]
    assert expected in line


def test_fault_of_no_rule_is_red(any_device, tmp_path):
    one = "suite.GROUPS = groups.GROUPS = {'made_up': {'it': lambda run: Measurement(Rule('one', 'a', 'b'), 0.0)}}"
    assert run_suite(tmp_path, one).returncode == 0
    done = run_suite(tmp_path, one + "\nmade.faults = [suite.Fault('', 'no such rule', 'evidence', 1.0)]")
    assert done.returncode == 1, done.stdout
    assert "ERROR: known_faults.toml: no such rule" in done.stdout


def test_wrong_use_is_told(any_device, tmp_path, capsys, monkeypatch):
    assert main(["conformance", "--only", "nonsense"]) == 2
    assert "ray_queries" in capsys.readouterr().err
    assert main(["conformance", "--html", str(tmp_path / "none" / "report.html")]) == 2
    assert main(["conformance", "--device", "no such device"]) == 3
    monkeypatch.setitem(sys.modules, "pytest", None)
    assert main(["conformance"]) == 2
    assert "pip install solari-vk[test]" in capsys.readouterr().err
