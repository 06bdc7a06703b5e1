"""Reflections."""

from __future__ import annotations

from solari_vk.conformance import specular_checks as checks
from solari_vk.conformance.suite import Recorder
from solari_vk.gpu.device.device import Device


def test_mirror(rule: Recorder, device: Device) -> None:
    """A flat mirror."""
    rule(checks.measure_mirror(device))


def test_gallery(rule: Recorder, device: Device) -> None:
    """Metals of four roughnesses."""
    rule(checks.measure_gallery(device))


def test_termination(rule: Recorder, device: Device) -> None:
    """Where paths end."""
    rule(checks.measure_termination(device))
