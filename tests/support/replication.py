"""Replicated runs of the realtime renderer: independent seeds, each with a history of its own (P-REPL)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.renderers.renderer import Renderer
from solari_vk.renderers.results import RenderedFrame
from solari_vk.scene.model import Camera

RUNS, WARM_UP = 16, 24


def replicate(renderer: Renderer, runs: int, observe: Callable[[], ArrayLike]) -> NDArray[np.float64]:
    """What `observe` returns after a reset with each of the seeds 0 to runs - 1, (runs, ...); all must be finite."""
    found = []
    for seed in range(runs):
        renderer.seed = seed
        renderer.reset()
        found.append(np.asarray(observe(), np.float64))
        assert np.isfinite(found[-1]).all(), f"seed {seed}: a value is not finite"
    return np.stack(found)


def observe_runs(
    renderer: Renderer,
    camera: Camera,
    read: str | Callable[[RenderedFrame], Any] = "radiance",
    *,
    runs: int = RUNS,
    warm_up: int = WARM_UP,
    observed: int = 1,
) -> NDArray[np.float64]:
    """One observation of each of `runs` independent runs, (runs, ...).

    A run is a reset, `warm_up` frames and `observed` more; its observation is the mean over the latter of what `read`
    gives, the name of a result or a function of the frame.
    """
    take = (lambda frame: frame[read]) if isinstance(read, str) else read

    def observe() -> NDArray[np.float64]:
        for _ in range(warm_up):
            renderer.render(camera)
        total: Any = 0.0
        for _ in range(observed):
            total = total + np.asarray(take(renderer.render(camera)), np.float64)
        return np.asarray(total / observed)

    return replicate(renderer, runs, observe)
