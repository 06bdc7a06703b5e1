"""Acceleration structures: all ways of building, all formats; large, many and empty ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from solari_vk.conformance import structure_checks as checks
from solari_vk.conformance.rules import Measurement
from solari_vk.conformance.shader_runner import ShaderRunner
from solari_vk.conformance.suite import Recorder

Check = Callable[[ShaderRunner], Iterator[Measurement]]
_CHECKS = {
    "ways": checks.measure_ways,
    "formats": checks.measure_formats,
    "indices": checks.measure_indices,
    "nothing": checks.measure_nothing,
    "rebuilds": checks.measure_tlas_rebuilds,
}


@pytest.mark.parametrize("measure", [pytest.param(check, id=name) for name, check in _CHECKS.items()])
def test_structures(rule: Recorder, shaders: ShaderRunner, measure: Check) -> None:
    """The checks that need no size."""
    rule(measure(shaders))


def test_many_blases(rule: Recorder, shaders: ShaderRunner, full: bool) -> None:
    """Many structures in one call."""
    rule(checks.measure_many_blases(shaders, 2000 if full else 500))


@pytest.mark.parametrize("count", [100_000, 1_000_000])
def test_large_tlas(rule: Recorder, shaders: ShaderRunner, full: bool, count: int) -> None:
    """A grid of instances, with a ray at each."""
    most = int(shaders.device.properties.acceleration.maxInstanceCount)
    if count > most:
        rule.unsupported(checks.large_tlas_rule(count), f"maxInstanceCount is {most:,}")
    elif count > 100_000 and not full:
        rule.full_only(checks.large_tlas_rule(count))
    else:
        rule(checks.measure_large_tlas(shaders, count))
