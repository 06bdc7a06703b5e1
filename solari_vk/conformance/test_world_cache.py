"""The world-space radiance cache."""

from __future__ import annotations

from solari_vk.conformance import realtime_checks as checks
from solari_vk.conformance.suite import Recorder
from solari_vk.gpu.device import Device


def test_map(rule: Recorder, device: Device) -> None:
    """Its hash map."""
    rule(checks.measure_world_cache(device))
