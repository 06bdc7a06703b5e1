"""The path tracer of solari_vk."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

import solari_vk as sv


def load(job: dict[str, Any], folder: Path) -> Callable[[int, int], NDArray[Any]]:
    """A function that renders the scene; see child.py."""
    scene, camera = pickle.loads((folder / "scene.pickle").read_bytes())
    device = sv.Device(job["device"], rays=job["rays"])
    tracer = sv.PathTracer(device, scene, tuple(job["size"]), max_bounces=job["max_bounces"])

    def render(samples: int, seed: int, denoise: bool = False) -> NDArray[Any]:
        tracer.seed = seed  # which begins a new picture, unless the seed is the same
        tracer.reset()
        return tracer.render(camera, samples=samples, denoise=denoise)["radiance"]

    return render
