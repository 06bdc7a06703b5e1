"""Runs the table of groups."""

from __future__ import annotations

import pytest

from solari_vk.conformance.groups import GROUPS, Run


@pytest.mark.parametrize(("group", "case"), [(group, case) for group, cases in GROUPS.items() for case in cases])
def test_group(run: Run, group: str, case: str) -> None:
    """Measure one case of a group."""
    run.rule(GROUPS[group][case](run))
