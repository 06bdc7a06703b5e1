"""Light tiles: samples of lights, drawn and packed ahead."""

from __future__ import annotations

from solari_vk.conformance import light_tile_checks as checks
from solari_vk.conformance.shader_runner import ShaderRunner
from solari_vk.conformance.suite import Recorder
from solari_vk.gpu.device.device import Device


def test_tiles(rule: Recorder, device: Device) -> None:
    """What is in them."""
    rule(checks.measure_tiles(device))


def test_contribution(rule: Recorder, device: Device, shaders: ShaderRunner) -> None:
    """What a sample does, packed or not."""
    rule(checks.measure_contribution(device, shaders))


def test_noise(rule: Recorder, device: Device) -> None:
    """What they are for."""
    rule(checks.measure_noise(device))
