"""Direct light by ReSTIR DI."""

from __future__ import annotations

from solari_vk.conformance import direct_checks as checks
from solari_vk.conformance.suite import Recorder
from solari_vk.gpu.device.device import Device


def test_direct(rule: Recorder, device: Device, full: bool) -> None:
    """Means: of all, in light, in penumbra and in shadow."""
    rule(checks.measure_direct(device, checks.FULL if full else checks.FAST))


def test_changes(rule: Recorder, device: Device, full: bool) -> None:
    """Lights that come and go."""
    rule(checks.measure_changes(device, full))
