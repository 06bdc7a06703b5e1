"""Fixtures of the suite. Without the command `solari-vk conformance`, the environment sets a run up."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from solari_vk.conformance.shader_runner import ShaderRunner
from solari_vk.conformance.suite import Recorder, Suite
from solari_vk.gpu.device.device import Device


def pytest_configure(config: pytest.Config) -> None:
    """Register the suite unless `solari_vk.conformance.run` did."""
    if not any(isinstance(plugin, Suite) for plugin in config.pluginmanager.get_plugins()):
        config.pluginmanager.register(Suite.from_environment(), "solari_vk conformance")


@pytest.fixture(scope="session")
def suite(request: pytest.FixtureRequest) -> Suite:
    """The suite that runs this test."""
    plugins = request.config.pluginmanager.get_plugins()
    return next(plugin for plugin in plugins if isinstance(plugin, Suite))


@pytest.fixture(scope="session")
def device(suite: Suite) -> Device:
    """The device under test."""
    return suite.device


@pytest.fixture(scope="session")
def shaders(device: Device) -> Iterator[ShaderRunner]:
    """Runs passes/NAME.comp of the package over arrays."""
    with ShaderRunner(device) as made:
        yield made


@pytest.fixture
def rule(request: Any, suite: Suite) -> Recorder:
    """Records what the test measures: rule(measurement) or rule(measurements)."""
    return suite.recorder(request.node)


@pytest.fixture(scope="session")
def full(suite: Suite) -> bool:
    """Whether this is the full profile, which measures more; `rule.full_only` records what others leave out."""
    return suite.full
