"""The reference path tracer, by which all else will be measured."""

from __future__ import annotations

import pytest

from solari_vk.conformance import path_checks as checks
from solari_vk.conformance.suite import Recorder
from solari_vk.gpu.device.device import Device


@pytest.mark.parametrize("bounces", [0, 1, 5])
def test_series(rule: Recorder, device: Device, bounces: int) -> None:
    """A closed box."""
    rule(checks.measure_series(device, bounces))


@pytest.mark.parametrize("metallic", [0.0, 1.0])
@pytest.mark.parametrize("roughness", [0.0, 0.15, 0.5, 1.0])
def test_white_box(rule: Recorder, device: Device, roughness: float, metallic: float) -> None:
    """A white closed box of the full material."""
    rule(checks.measure_white_box(device, roughness, metallic))


def test_light_tight(rule: Recorder, device: Device) -> None:
    """A closed surface."""
    rule(checks.measure_light_tight(device))


def test_seeds(rule: Recorder, device: Device) -> None:
    """Seeds."""
    rule(checks.measure_seeds(device))
