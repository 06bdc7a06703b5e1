"""Indirect light by ReSTIR GI."""

from __future__ import annotations

from solari_vk.conformance import indirect_checks as checks
from solari_vk.conformance.suite import Recorder
from solari_vk.gpu.device.device import Device


def test_indirect(rule: Recorder, device: Device, full: bool) -> None:
    """The mean of one bounce."""
    rule(checks.measure_indirect(device, checks.FULL if full else checks.FAST))
