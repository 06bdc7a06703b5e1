"""Fixtures of the suite. Without `solari-vk conformance` around it, a run is set up from the environment."""

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
    """The run."""
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
    """rule(measurement or measurements): what the test has found."""
    return suite.recorder(request.node)


@pytest.fixture(scope="session")
def full(suite: Suite) -> bool:
    """Whether to measure ten times as much; what is measured only then is given to `rule.full_only` otherwise."""
    return suite.full
