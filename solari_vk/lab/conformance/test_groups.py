"""Runs the table of groups."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest

from solari_vk.lab.conformance.faults import find_end, unexplained
from solari_vk.lab.conformance.groups import GROUPS
from solari_vk.lab.conformance.outcomes import FAULT, RED, Check, Outcome
from solari_vk.lab.conformance.worker import Worker

CHECKS = [Check(group, case) for group, cases in GROUPS.items() for case in cases]
# Each has a cheaper case beside it.
SLOW = ("large_tlas-1000000", "embree-mesh of a million", "probes-rebuilt", "probes-refitted", "probes-compacted")
_measured: dict[Check, list[Outcome]] = {}


@pytest.mark.parametrize(
    "check",
    [
        pytest.param(check, id=f"{check.group}-{check.case}", marks=[pytest.mark.slow] if check.case in SLOW else [])
        for check in CHECKS
    ],
)
def test_check(worker_of: Callable[[str], Worker], check: Check) -> None:
    """Measure one check, unless it is known that the driver doesn't survive it."""
    worker = worker_of(check.group)
    fault = find_end(worker.faults, check)
    if fault:
        _measured[check] = [Outcome(check.group, check.rule, FAULT, check.case)]
        pytest.xfail(f"not run: ends by {fault.ends}. {fault.evidence}")
    outcomes = _measured.setdefault(check, [])
    worker.measure(check, outcomes.append)
    red = [outcome for outcome in outcomes if outcome.status in RED]
    if red:
        pytest.fail(_list(red), pytrace=False)
    known = [outcome for outcome in outcomes if outcome.status == FAULT]
    if known:
        pytest.xfail(_list(known))
    if all(outcome.measurement is None for outcome in outcomes):
        pytest.skip(_list(outcomes))


def test_known_faults_are_of_rules(worker_of: Callable[[str], Worker]) -> None:
    """Each entry of known_faults.toml for this driver is about a rule of the checks that aren't slow."""
    if any(check not in _measured for check in CHECKS if check.case not in SLOW):
        pytest.skip("not all checks were run")
    assert not unexplained(worker_of("").faults, [outcome for found in _measured.values() for outcome in found])


def _list(outcomes: Sequence[Outcome]) -> str:
    return "\n".join(str(o.measurement or o.rule.name) + (f" ({o.reason})" if o.reason else "") for o in outcomes)
