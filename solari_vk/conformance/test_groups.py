"""Runs the table of groups."""

from __future__ import annotations

import pytest

from solari_vk.conformance.groups import GROUPS, Run
from solari_vk.conformance.shader_runner import ShaderRunner
from solari_vk.conformance.suite import Recorder


@pytest.mark.parametrize(("group", "case"), [(group, case) for group, cases in GROUPS.items() for case in cases])
def test_group(rule: Recorder, shaders: ShaderRunner, full: bool, group: str, case: str) -> None:
    """Measure one case of a group."""
    rule(GROUPS[group][case](Run(rule, shaders, full)))
