"""Fixtures for tests of the suite: its shaders, unchanged and with seeded bugs."""

from __future__ import annotations

from contextlib import contextmanager

import pytest
from support.seeded_bugs import seeded

from solari_vk.gpu.device.device import Device
from solari_vk.lab.shader_runner import ShaderRunner


@pytest.fixture(scope="session")
def shaders(device):
    """The suite's shaders under validation."""
    with ShaderRunner(device) as made:
        yield made


@pytest.fixture(scope="session")
def ray_shaders(any_device):
    """The suite's shaders on a device that traces by ray pipelines, under validation."""
    with Device(validation=True, rays="pipeline") as opened:
        with ShaderRunner(opened) as made:
            yield made
        opened.wait_idle()


@pytest.fixture(scope="session")
def patched(device):
    """patched(bug, ..., device=None): a context with a runner of shaders with these seeded bugs."""

    @contextmanager
    def make(*bugs, device=device):
        with seeded(*bugs), ShaderRunner(device) as made:
            yield made

    return make


@pytest.fixture(scope="session")
def plain_device(any_device):
    """A device without validation, for extensions that an old validation layer hides."""
    with Device(validation=False) as opened:
        yield opened
