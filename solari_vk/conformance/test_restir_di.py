"""Direct light by ReSTIR DI."""

from __future__ import annotations

from solari_vk.conformance import realtime_checks as checks
from solari_vk.conformance.suite import Recorder
from solari_vk.gpu.device import Device


def test_direct(rule: Recorder, device: Device) -> None:
    """The mean."""
    rule(checks.measure_direct(device))
