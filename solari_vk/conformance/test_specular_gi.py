"""Reflections."""

from __future__ import annotations

from solari_vk.conformance import indirect_checks as checks
from solari_vk.conformance.suite import Recorder
from solari_vk.gpu.device.device import Device


def test_mirror(rule: Recorder, device: Device) -> None:
    """A flat mirror."""
    rule(checks.measure_mirror(device))
