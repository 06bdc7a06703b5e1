"""Runs this folder's shaders, which include the renderer's library, unchanged or with seeded bugs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import pytest

from solari_vk.conformance.shader_runner import ShaderRunner
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.shaders.patches import Patch, patched_shaders


@pytest.fixture(scope="session")
def shaders(device: Device) -> Iterator[ShaderRunner]:
    """A runner of the unchanged shader library."""
    with ShaderRunner(device, Path(__file__).parent) as runner:
        yield runner


Patched = Callable[..., AbstractContextManager[ShaderRunner]]


@pytest.fixture
def patched(device: Device) -> Patched:
    """patched(*patches): the shader library with patches, as a context."""

    @contextmanager
    def make(*patches: Patch) -> Iterator[ShaderRunner]:
        with patched_shaders(*patches), ShaderRunner(device, Path(__file__).parent) as runner:
            yield runner

    return make


@pytest.fixture
def expect_failure(patched: Patched) -> Callable[..., None]:
    """expect_failure(patch, check, ...): check(runner of the patched library, ...) must find something wrong."""

    def expect(patch: Patch, check: Callable[..., None], *arguments: Any) -> None:
        with patched(patch) as mutant, pytest.raises(AssertionError):
            check(mutant, *arguments)

    return expect
