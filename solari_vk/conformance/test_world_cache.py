"""The world-space radiance cache."""

from __future__ import annotations

from solari_vk.conformance import world_cache_checks as checks
from solari_vk.conformance.suite import Recorder
from solari_vk.gpu.device.device import Device


def test_map(rule: Recorder, device: Device) -> None:
    """Its hash map."""
    rule(checks.measure_world_cache(device))


def test_fixed_point(rule: Recorder, device: Device, full: bool) -> None:
    """What its cells hold."""
    rule(checks.measure_fixed_point(device, full))


def test_leak(rule: Recorder, device: Device) -> None:
    """Walls thinner than its cells."""
    rule(checks.measure_leak(device))
