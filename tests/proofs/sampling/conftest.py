"""Runs shaders of random numbers, packing and surfaces."""

from __future__ import annotations

from pathlib import Path

import pytest

from solari_vk.conformance.shader_runner import ShaderRunner

ROOT = Path(__file__).parent / "glsl"


def run_shaders(device):
    """A runner of this folder's shaders, which include the renderer's library."""
    return ShaderRunner(device, ROOT)


@pytest.fixture(scope="session")
def shaders(device):
    """A runner of the unchanged shader library."""
    with run_shaders(device) as runner:
        yield runner
