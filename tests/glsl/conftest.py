"""Runs this folder's shaders, which include the renderer's library, as it is or with seeded bugs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from solari_vk.conformance.shader_runner import ShaderRunner
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.shaders.patches import Patch, patched_shaders


@pytest.fixture(scope="session")
def shaders(device: Device) -> Iterator[ShaderRunner]:
    """The shader library as it is."""
    with ShaderRunner(device, Path(__file__).parent) as runner:
        yield runner


@pytest.fixture
def expect_failure(device: Device) -> Callable[..., None]:
    """expect_failure(patch, check, ...): check(runner of the patched library, ...) must find something wrong."""

    def expect(patch: Patch, check: Callable[..., None], *arguments: Any) -> None:
        root = Path(__file__).parent
        with patched_shaders(patch), ShaderRunner(device, root) as mutant, pytest.raises(AssertionError):
            check(mutant, *arguments)

    return expect
