"""Realtime frames of solari_vk, denoised and antialiased, of a camera in motion."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

import solari_vk as sv
from solari_vk.output.animation import orbit

STEPS = 720  # frames of a turn about the scene


def load(job: dict[str, Any], folder: Path) -> Callable[[int, int], NDArray[Any]]:
    """A function of a number of frames and a seed that renders them, and returns the last one, which shows the scene's
    camera; see child.py. Each frame has a camera of its own."""
    scene, camera = pickle.loads((folder / "scene.pickle").read_bytes())
    device = sv.Device(job["device"], rays=job["rays"])
    renderer = sv.Renderer(device, scene, tuple(job["size"]), sv.Settings(paths_bounces=job["max_bounces"]))
    path = orbit(camera, scene.bounds.center, STEPS)

    def render(frames: int, seed: int) -> NDArray[Any]:
        renderer.seed = seed
        renderer.reset()
        for moved in (2 * path)[STEPS + 1 - frames : STEPS + 1]:
            frame = renderer.render(moved)
        return frame["radiance"]

    return render
