"""Indirect light by ReSTIR GI."""

from __future__ import annotations

from solari_vk.conformance import realtime_checks as checks
from solari_vk.conformance.suite import Recorder
from solari_vk.gpu.device import Device


def test_indirect(rule: Recorder, device: Device) -> None:
    """The mean of one bounce."""
    rule(checks.measure_indirect(device))
