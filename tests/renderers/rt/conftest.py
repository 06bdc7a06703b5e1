"""Fixtures for tests of acceleration structures: short ways to make them, and a check that nothing leaks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.frames import leaves_nothing
from support.scenes import ABOVE_QUAD, DOWN, quad_corners

from solari_vk import rt
from solari_vk.lab.shader_runner import ShaderRunner
from solari_vk.lab.structures import trace


@pytest.fixture(scope="session")
def shaders(device):
    """The suite's shaders; pipelines and staging chunks exist already, so that tests can count what is alive."""
    with ShaderRunner(device) as runner:
        nothing = rt.create_tlas(device, 1)
        for _ in range(8):
            rt.build_acceleration_structures(device, (), [rt.TlasPackage(nothing, [None])])
        for _ in range(2):  # frames have two slots
            trace(runner, nothing, ABOVE_QUAD, DOWN)
        nothing.destroy()
        yield runner


class World:
    """Makes structures and buffers on one device, and destroys all of them in the end."""

    def __init__(self, shaders):
        self.device, self._shaders = shaders.device, shaders
        self._made: list[Any] = []

    def keep(self, item):
        self._made.append(item)
        return item

    def blas(self, geometries=None, **options):
        return self.keep(rt.create_blas(self.device, geometries or [rt.Triangles(quad_corners())], **options))

    def tlas(self, max_instances=4, **options):
        return self.keep(rt.create_tlas(self.device, max_instances, **options))

    def entry(self, blas, *geometries):
        return rt.BlasBuildEntry(blas, geometries or [rt.Triangles(quad_corners())])

    def build(self, blases=(), tlases=()):
        return rt.build_acceleration_structures(self.device, blases, tlases)

    def buffer(self, array, dtype=np.float32):
        data = np.ascontiguousarray(array, dtype)
        buffer = self.keep(self.device.buffer(data.nbytes, "data"))
        buffer.upload(data)
        return buffer

    def trace(self, tlas, origins=ABOVE_QUAD, directions=DOWN, **options):
        """The closest hits; t < 0 is a miss. See `lab.structures.trace`."""
        return trace(self._shaders, tlas, origins, directions, **options)

    def is_hit(self, tlas):
        """Whether a ray from CENTER hits the quad."""
        return bool(self.trace(tlas)["t"][0] == 5)

    def close(self):
        for item in self._made:
            item.destroy()


@pytest.fixture
def world(device, shaders):
    with leaves_nothing(device):
        made = World(shaders)
        yield made
        made.close()


@pytest.fixture
def built(world):
    """built(...) -> a built Blas over a quad, and a built Tlas over it."""

    def make(**options):
        blas, tlas = world.blas(name="quad", **options), world.tlas(name="top")
        world.build([world.entry(blas)], [rt.TlasPackage(tlas, [rt.TlasInstance(blas)])])
        return blas, tlas

    return make
