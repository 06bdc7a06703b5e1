"""The suite as tests: one device measures all checks, in the process of pytest, so that a crash of the driver ends it.

`solari-vk conformance` outlives such a driver, and writes reports."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from solari_vk.conformance.worker import Work, Worker


@pytest.fixture(scope="session")
def worker() -> Iterator[Worker]:
    """The device under test."""
    with Worker(Work()) as opened:
        yield opened
