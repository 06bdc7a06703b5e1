"""The realtime frame as a whole."""

from __future__ import annotations

import pytest

from solari_vk.conformance import frame_checks as checks
from solari_vk.conformance.suite import Recorder
from solari_vk.gpu.device.device import Device


def test_determinism(rule: Recorder, device: Device) -> None:
    """Seeds."""
    rule(checks.measure_determinism(device))


def test_finite(rule: Recorder, device: Device) -> None:
    """Odd scenes."""
    rule(checks.measure_finite(device))


@pytest.mark.parametrize("walls", checks.QUICK_BOXES)
def test_closed_box(rule: Recorder, device: Device, full: bool, walls: str) -> None:
    """Energy."""
    rule(checks.measure_closed_box(device, walls, checks.BOX_FULL if full else checks.BOX_FAST))


def test_light(rule: Recorder, device: Device, full: bool) -> None:
    """A Cornell box, lit and dark."""
    rule(checks.measure_light(device, checks.LIGHT_FULL if full else checks.LIGHT_FAST))
