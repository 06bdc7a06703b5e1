"""Guide buffers for denoisers, and the parts that the light comes in."""

from __future__ import annotations

import pytest

from solari_vk.conformance import guide_checks as checks
from solari_vk.conformance.suite import Recorder
from solari_vk.gpu.device.device import Device


@pytest.mark.parametrize("name", checks.MIRRORS)
def test_mirrors(rule: Recorder, device: Device, name: str) -> None:
    """Primary surface replacement."""
    rule(checks.measure_mirrors(device, name))


def test_range(rule: Recorder, device: Device) -> None:
    """Odd scenes."""
    rule(checks.measure_range(device))


def test_parts(rule: Recorder, device: Device) -> None:
    """A sum."""
    rule(checks.measure_parts(device))
