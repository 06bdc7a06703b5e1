"""Lights against closed forms, by every way of sampling them."""

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
    [(0.0093, "mis"), (0.0093, "nee"), (0.8, "mis"), (0.8, "nee"), (0.8, "brdf")],  # directions never meet a small sun
)
def test_sun(rule: Recorder, device: Device, diameter: float, strategy: str) -> None:
    """A sun over a floor."""
    rule(checks.measure_sun(device, diameter, strategy))


def test_invariance(rule: Recorder, device: Device) -> None:
    """The same light, told otherwise."""
    rule(checks.measure_invariance(device))
