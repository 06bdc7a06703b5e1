"""Lights against closed forms, with each light strategy."""

from __future__ import annotations

import pytest

from solari_vk.conformance import light_checks as checks
from solari_vk.conformance.suite import Recorder
from solari_vk.gpu.device.device import Device


@pytest.mark.parametrize("strategy", ["mis", "nee", "brdf"])
def test_lamp(rule: Recorder, device: Device, strategy: str) -> None:
    """A lamp over a floor."""
    rule(checks.measure_lamp(device, strategy))


@pytest.mark.parametrize(
    ("diameter", "strategy"),
    # Not "brdf" for the small sun, which random directions almost never meet.
    [(0.0093, "mis"), (0.0093, "nee"), (0.8, "mis"), (0.8, "nee"), (0.8, "brdf")],
)
def test_sun(rule: Recorder, device: Device, diameter: float, strategy: str) -> None:
    """A sun over a floor."""
    rule(checks.measure_sun(device, diameter, strategy))


def test_invariance(rule: Recorder, device: Device) -> None:
    """The same light, described differently."""
    rule(checks.measure_invariance(device))
