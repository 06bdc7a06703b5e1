"""The suite as tests: the process of pytest measures all checks, so that a crash of the driver ends it.

`solari-vk conformance` outlives such a driver, and writes reports."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

from solari_vk.lab.conformance.groups import RAYS
from solari_vk.lab.conformance.worker import SuiteOptions, Worker


@pytest.fixture(scope="session")
def worker_of() -> Iterator[Callable[[str], Worker]]:
    """worker_of(group): the device under test, opened for the way to trace rays that the group is about."""
    with ExitStack() as stack:
        made: dict[tuple[str, ...], Worker] = {}

        def find(group: str) -> Worker:
            rays = RAYS.get(group, ())
            if rays not in made:
                made[rays] = stack.enter_context(Worker(SuiteOptions(), group))
            return made[rays]

        yield find
