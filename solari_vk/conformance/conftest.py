"""Fixtures of the suite. Without the command `solari-vk conformance`, the environment sets a run up."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from solari_vk.conformance.groups import Run
from solari_vk.conformance.shader_runner import ShaderRunner
from solari_vk.conformance.suite import Suite


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
def shaders(suite: Suite) -> Iterator[ShaderRunner]:
    """The suite's shaders on the device under test."""
    with ShaderRunner(suite.device) as made:
        yield made


@pytest.fixture
def run(request: pytest.FixtureRequest, suite: Suite, shaders: ShaderRunner) -> Run:
    """What the check of this test may use."""
    return Run(suite.recorder(request.node), shaders, suite.full)
