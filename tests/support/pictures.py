"""Path-traced pictures with measured variances, and their comparison with what is expected."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from solari_vk.conformance.rules import Measurement, Rule
from solari_vk.reference import PathTracer
from support.statistics import compare


@dataclass
class Picture:
    """A picture as R independent parts of its samples, (R, h, w, 3)."""

    runs: Any

    @property
    def mean(self):
        """The mean of the parts (h, w, 3), float64."""
        return self.runs.mean(axis=0, dtype=np.float64)

    @property
    def variance(self):
        """The variance of the mean (h, w, 3)."""
        return self.runs.var(axis=0, ddof=1, dtype=np.float64) / len(self.runs)


def take_picture(device, scene, size=(48, 48), samples=64, *, runs=8, camera=None, **settings):
    """Take a picture of `samples` per pixel in `runs` consecutive parts; settings are those of PathTracer.

    The variance comes from the spread of the parts, not from the renderer's own estimate.
    """
    part = max(samples // runs, 1)
    sums = [np.zeros((size[1], size[0], 3))]
    with PathTracer(device, scene, size, **settings) as renderer:
        for run in range(1, runs + 1):
            image = renderer.render(camera or scene.camera, samples=run * part)["radiance"]
            assert (image.shape, image.dtype) == (sums[0].shape, np.float32)
            assert np.isfinite(image).all()
            sums.append(image * np.float64(run * part))
    return Picture(np.diff(np.stack(sums), axis=0) / part)


def compare_picture(name, source, made, expected, bar, variance=0.0, tile=8):
    """Compare a picture with `expected` (h, w, 3): the mean within the bar, and each tile within statistical error."""
    found = compare(made.mean, made.variance, expected, variance, tile)
    mean, tiles = (Rule(f"{name}: {part}", *source) for part in ("mean", "tiles"))
    return [
        Measurement(mean, found.reach, bar, "relative error"),
        Measurement(tiles, found.max_z, found.z_bar, "standard errors"),
    ]
