"""Fixtures of the path tracer's proofs: path tracers that are closed, and pictures with measured variances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

import solari_vk as sv


@dataclass
class Picture:
    """Independent parts of one picture's samples, runs (R, h, w, 3): their mean, and the variance of that mean."""

    runs: np.ndarray

    @property
    def mean(self):
        return self.runs.mean(axis=0, dtype=np.float64)

    @property
    def variance(self):
        return self.runs.var(axis=0, ddof=1, dtype=np.float64) / len(self.runs)


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


@pytest.fixture
def picture(tracer):
    """picture(scene, size, samples, runs=8, camera=None, **settings of PathTracer) -> Picture.

    samples is the total per pixel. The variance comes from the spread of consecutive parts of the
    samples, not from the renderer's own estimate, which has its own test.
    """

    def make(scene, size=(48, 48), samples=64, *, runs=8, camera=None, **settings):
        renderer = tracer(scene, size, **settings)
        part = max(samples // runs, 1)
        sums = [np.zeros((size[1], size[0], 3))]
        for run in range(1, runs + 1):
            image = renderer.render(camera or scene.camera, samples=run * part)
            assert image.shape == sums[0].shape
            assert image.dtype == np.float32
            assert np.isfinite(image).all()
            sums.append(image * np.float64(run * part))
        renderer.close()
        return Picture(np.diff(np.stack(sums), axis=0) / part)

    return make
