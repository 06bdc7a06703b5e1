"""Runs this folder's shaders, which include the renderer's library, unchanged or with seeded bugs."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path

import pytest

from solari_vk.conformance.shader_runner import ShaderRunner
from solari_vk.gpu.shaders.patches import patched_shaders


@pytest.fixture(scope="session")
def shaders(device):
    """A runner of the unchanged shader library."""
    with ShaderRunner(device, Path(__file__).parent) as runner:
        yield runner


@pytest.fixture
def patched(device):
    """patched(*patches): the shader library with patches, as a context."""

    @contextmanager
    def make(*patches):
        with patched_shaders(*patches), ShaderRunner(device, Path(__file__).parent) as runner:
            yield runner

    return make


@pytest.fixture
def expect_failure(patched):
    """expect_failure(patch, check, ...): check(runner of the patched library, ...) must find something wrong."""

    def expect(patch, check, *arguments):
        with patched(patch) as mutant, pytest.raises(AssertionError):
            check(mutant, *arguments)

    return expect
