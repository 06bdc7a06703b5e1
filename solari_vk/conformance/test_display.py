"""The shown picture, and the debug views."""

from __future__ import annotations

from solari_vk.conformance import display_checks as checks
from solari_vk.conformance.suite import Recorder
from solari_vk.gpu.device.device import Device


def test_picture(rule: Recorder, device: Device) -> None:
    """Exposure and curves."""
    rule(checks.measure_picture(device))


def test_views(rule: Recorder, device: Device) -> None:
    """Debug views."""
    rule(checks.measure_views(device))
