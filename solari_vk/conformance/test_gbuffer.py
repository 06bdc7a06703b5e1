"""What every pixel shows."""

from __future__ import annotations

from solari_vk.conformance import realtime_checks as checks
from solari_vk.conformance.suite import Recorder
from solari_vk.gpu.device import Device


def test_gbuffer(rule: Recorder, device: Device) -> None:
    """Surfaces and motion."""
    rule(checks.measure_gbuffer(device))
