"""Fixtures of the suite's own tests: its shaders as they are, and with seeded bugs."""

from __future__ import annotations

from contextlib import contextmanager

import pytest
from seeded_bugs import patched_root

from solari_vk.conformance.kernels import Kernels
from solari_vk.gpu.device.device import Device


@pytest.fixture(scope="session")
def kernels(device):
    """The suite's shaders under validation."""
    with Kernels(device) as made:
        yield made


@pytest.fixture
def patched(device, tmp_path):
    """patched((file, old, new), ..., device=None) -> Kernels over shaders with these seeded bugs."""

    @contextmanager
    def make(*patches, device=device):
        with Kernels(device, patched_root(tmp_path, *patches)) as made:
            yield made

    return make


@pytest.fixture(scope="session")
def plain_device(any_device):
    """A device without validation, for what an old layer hides."""
    with Device(validation=False) as opened:
        yield opened
