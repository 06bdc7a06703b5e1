"""The surface model."""

from __future__ import annotations

import pytest

from solari_vk.conformance import brdf_checks as checks
from solari_vk.conformance.shader_runner import ShaderRunner
from solari_vk.conformance.suite import Recorder


@pytest.mark.parametrize("metallic", [0.0, 0.5, 1.0])
def test_white_furnace(rule: Recorder, shaders: ShaderRunner, metallic: float) -> None:
    """A white surface reflects all light."""
    rule(checks.measure_furnace(shaders, metallic))


def test_draws(rule: Recorder, shaders: ShaderRunner) -> None:
    """Samples follow their density."""
    rule(checks.measure_draws(shaders, checks.CASES, 1_000_000))


def test_numbers(rule: Recorder, shaders: ShaderRunner) -> None:
    """Values and samples are finite and not negative."""
    rule(checks.measure_numbers(shaders, 1_000_000))
