"""Fixtures for tests of the path tracer: path tracers that close themselves, and pictures with measured variances."""

from __future__ import annotations

import functools

import pytest
from support.pictures import take_picture

import solari_vk as sv


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
    return functools.partial(take_picture, device)
