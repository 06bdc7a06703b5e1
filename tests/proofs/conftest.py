"""Fixtures for proofs: path tracers that close themselves, pictures with measured variances, and shaders."""

from __future__ import annotations

import functools

import pytest
from support.frames import path_traced_runs

import solari_vk as sv
from solari_vk.lab.shader_runner import ShaderRunner


@pytest.fixture
def tracer(device):
    """tracer(scene, size, **settings) -> PathTracer, closed when the test ends."""
    made = []

    def make(scene, size, **settings):
        made.append(sv.PathTracer(device, scene, size, **settings))
        return made[-1]

    yield make
    for renderer in made:
        renderer.close()


@pytest.fixture(scope="session")
def picture(device):
    """picture(scene, size, samples, runs=8, camera=None, **settings of PathTracer) -> Picture; see take_picture."""
    return functools.partial(path_traced_runs, device)


@pytest.fixture(scope="module")
def shaders(device, request):
    """A runner of the shaders beside a proof, in the folder glsl, which include the renderer's library."""
    with ShaderRunner(device, request.path.parent / "glsl") as runner:
        yield runner
