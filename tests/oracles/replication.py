"""Replicated runs of the realtime renderer for P-REPL: independent seeds, each with its own history."""

from collections.abc import Callable
from typing import Any

import numpy as np

SEEDS = 16
WARM_UP = 24


def runs(renderer, camera, read: str | Callable[[Any], np.ndarray] = "radiance", *, seeds=SEEDS, warm_up=WARM_UP,
         observed=1):  # fmt: skip
    """What `read` finds in the last frames of independent runs, (seeds, ...).

    A run is a reset, `warm_up` frames and then `observed` more, whose mean is the run's one observation. `read` is a
    result's name or a function of the frame.
    """
    take = (lambda frame: frame[read]) if isinstance(read, str) else read
    observations = []
    for seed in range(seeds):
        renderer.seed = seed
        renderer.reset()
        for _ in range(warm_up):
            renderer.render(camera)
        total = 0.0
        for _ in range(observed):
            total = total + np.asarray(take(renderer.render(camera)), np.float64)
        observations.append(total / observed)
        assert np.isfinite(observations[-1]).all(), f"seed {seed}: not finite"
    return np.stack(observations)


def tiles(images, count=4):
    """Means over count x count tiles of pictures (..., height, width, channels): (..., count, count, channels)."""
    images = np.asarray(images, np.float64)
    *front, height, width, channels = images.shape
    assert height % count == width % count == 0
    split = images.reshape(*front, count, height // count, count, width // count, channels)
    return split.mean(axis=(-4, -2))


def relative_interval(observations, truth):
    """The relative error of the mean over runs of the global mean, and the half width of its 95 % interval."""
    from scipy import stats

    means = observations.reshape(len(observations), -1).mean(axis=1) / float(np.mean(truth)) - 1
    half_width = stats.t.ppf(0.975, len(means) - 1) * means.std(ddof=1) / np.sqrt(len(means))
    return float(means.mean()), float(half_width)
