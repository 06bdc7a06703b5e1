"""What every pixel shows."""

from __future__ import annotations

import pytest

from solari_vk.conformance import gbuffer_checks as checks
from solari_vk.conformance.suite import Recorder
from solari_vk.gpu.device.device import Device


@pytest.mark.parametrize("scene", checks.SCENES)
def test_raster(rule: Recorder, device: Device, scene: str) -> None:
    """Surfaces."""
    rule(checks.measure_raster(device, checks.make_scene(scene)))


@pytest.mark.parametrize("way", ["raster", "traced"])
def test_motion(rule: Recorder, device: Device, way: str) -> None:
    """Motion of the camera and of instances."""
    rule(checks.measure_motion(device, way))


def test_culling(rule: Recorder, device: Device) -> None:
    """What isn't drawn."""
    rule(checks.measure_culling(device))
