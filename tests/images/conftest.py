"""Fixtures of the path tracer's proofs: pictures with variances taken from independent runs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

import solari_vk as sv


@dataclass
class Picture:
    """mean (h, w, 3) of independent runs and the variance (h, w, 3) of that mean; runs (R, h, w, 3)."""

    runs: np.ndarray

    @property
    def mean(self):
        return self.runs.mean(axis=0, dtype=np.float64)

    @property
    def variance(self):
        return self.runs.var(axis=0, ddof=1, dtype=np.float64) / len(self.runs)


@pytest.fixture
def picture(device):
    """picture(scene, size, samples, runs=8, seed=1, camera=None, **settings of PathTracer) -> Picture.

    samples is the total per pixel. The variance comes from the spread of the runs, not from the
    renderer's own estimate, which has its own test.
    """

    def make(scene, size=(48, 48), samples=64, *, runs=8, seed=1, camera=None, **settings):
        images = []
        for run in range(runs):
            with_seed = sv.PathTracer(device, scene, size, seed=1000 * seed + run, **settings)
            image = with_seed.render(camera or scene.camera, samples=max(samples // runs, 1))
            assert image.shape == (size[1], size[0], 3)
            assert image.dtype == np.float32
            assert np.isfinite(image).all()
            images.append(image)
        return Picture(np.stack(images))

    return make
