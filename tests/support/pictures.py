"""Path-traced pictures with measured variances, and their comparison with what is expected."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from solari_vk.lab.conformance.rules import Measurement, Rule
from solari_vk.renderers.path_tracer import PathTracer
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
    """Take a picture of `samples` per pixel in `runs` parts of different seeds; settings are those of PathTracer.

    The variance comes from the spread of the parts, which are independent, as samples of one seed aren't.
    """
    parts = []
    with PathTracer(device, scene, size, **settings) as renderer:
        for run in range(runs):
            renderer.seed = settings.get("seed", 0) + 1000 * run
            image = renderer.render(camera or scene.camera, samples=max(samples // runs, 1))["radiance"]
            assert (image.shape, image.dtype) == ((size[1], size[0], 3), np.float32)
            assert np.isfinite(image).all()
            parts.append(image.astype(np.float64))
    return Picture(np.stack(parts))


def compare_picture(name, source, made, expected, bar, variance=0.0, tile=8):
    """Compare a picture with `expected` (h, w, 3): the mean within the bar, and each tile within statistical error."""
    found = compare(made.mean, made.variance, expected, variance, tile)
    mean, tiles = (Rule(f"{name}: {part}", *source) for part in ("mean", "tiles"))
    return [
        Measurement(mean, found.reach, bar, "relative error"),
        Measurement(tiles, found.max_z, found.z_bar, "standard errors"),
    ]
