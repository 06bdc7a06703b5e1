"""What every pixel shows."""

from __future__ import annotations

from solari_vk.conformance import gbuffer_checks as checks
from solari_vk.conformance.suite import Recorder
from solari_vk.gpu.device.device import Device


def test_gbuffer(rule: Recorder, device: Device) -> None:
    """Surfaces, and the camera's motion."""
    rule(checks.measure_gbuffer(device))


def test_instance_motion(rule: Recorder, device: Device) -> None:
    """The instances' motion."""
    rule(checks.measure_instance_motion(device))


def test_culling(rule: Recorder, device: Device) -> None:
    """What isn't drawn."""
    rule(checks.measure_culling(device))
