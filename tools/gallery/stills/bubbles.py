"""Soap bubbles: thin films in the light of a photograph.

A bubble is a thin wall of glass with a film of `iridescence`, which is thinner at the top, as gravity drains it. Each
color is a wavelength that the front and the back of the film reflect in step.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import solari_vk as sv

SAMPLES = 96
BUBBLES = (((-0.62, 0.12, 0), 0.30), ((0.05, -0.10, 0.35), 0.38), ((0.72, 0.18, -0.2), 0.24), ((0.36, 0.46, -0.7), 0.16),
           ((-0.22, 0.48, -0.9), 0.13), ((-1.15, -0.24, -0.9), 0.22), ((1.2, -0.26, -0.6), 0.20),
           ((0.98, 0.50, -1.6), 0.17), ((-0.95, 0.50, -1.5), 0.12))  # fmt: skip


def film(seed: int) -> sv.Material:
    """A film from 100 nm at the top to 800 nm, in swirls."""
    random = np.random.default_rng(seed)
    v, u = np.mgrid[0:256, 0:512] / (256, 512)[0]
    u = u / 2 * 2 * np.pi
    depth = v.copy()
    for octave in range(1, 5):
        waves = random.integers(1, 3, 2) * octave
        swirl = np.sin(waves[0] * u + 7 * octave * v + random.uniform(0, 6)) * np.sin(np.pi * v)
        depth += 0.10 / octave * swirl * np.cos(waves[1] * np.pi * v + random.uniform(0, 6))
    thickness = np.uint8(255 * np.clip(depth, 0, 1))[..., None].repeat(3, axis=-1)
    return sv.Material(transmission=1, roughness=0, ior=1.33, iridescence=1, iridescence_ior=1.33, double_sided=True,
                       iridescence_thickness=(100, 800), iridescence_thickness_texture=thickness)  # fmt: skip


def scene(assets: Path) -> sv.Scene:
    """Nine bubbles by the sea."""
    made = sv.Scene(name="bubbles")
    for number, (place, radius) in enumerate(BUBBLES):
        made.add(sv.shapes.sphere(radius, 96), film(number), place, name=f"bubble {number}")
    made.environment = sv.Environment(assets / "hdri" / "spiaggia_di_mondello_1k.hdr", rotation=0.5)
    made.camera = sv.Camera.look_at((0, -0.05, 3.2), (0, 0.1, 0), fov=27, auto_exposure=True)
    return made
