"""Soap bubbles: thin films before a dark wall.

A bubble is a film of water, `iridescence`, with air on both sides. It is thinner at the top, as gravity drains it. Each
color is a wavelength that the front and the back of the film reflect in step.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import solari_vk as sv

SAMPLES = 96
BUBBLES = (
    ((-0.62, 0.12, 0), 0.30),
    ((0.05, -0.10, 0.35), 0.38),
    ((0.72, 0.18, -0.2), 0.24),
    ((0.36, 0.46, -0.7), 0.16),
    ((-0.22, 0.48, -0.9), 0.13),
    ((-1.15, -0.24, -0.9), 0.22),
    ((1.2, -0.26, -0.6), 0.20),
    ((1.62, 0.55, -1.6), 0.17),
    ((-1.45, 0.62, -1.5), 0.12),
)


def film(seed: int) -> sv.Material:
    """A film from 120 nm at the top to 620 nm, in swirls, on a wall without reflections of its own (an ior of 1)."""
    random = np.random.default_rng(seed)
    v, u = np.mgrid[0:256, 0:512] * np.array((1 / 256, 2 * np.pi / 512))[:, None, None]
    depth = v.copy()
    for octave in range(1, 5):
        waves = random.integers(1, 3, 2) * octave
        swirl = np.sin(waves[0] * u + 7 * octave * v + random.uniform(0, 6)) * np.sin(np.pi * v)
        depth += 0.10 / octave * swirl * np.cos(waves[1] * np.pi * v + random.uniform(0, 6))
    thickness = np.uint8(255 * np.clip(depth, 0, 1))[..., None].repeat(3, axis=-1)
    return sv.Material(
        transmission=1,
        roughness=0,
        ior=1.0,
        iridescence=1,
        iridescence_ior=1.33,
        double_sided=True,
        iridescence_thickness=(120, 620),
        iridescence_thickness_texture=thickness,
    )


def scene(assets: Path) -> sv.Scene:
    """Nine bubbles between a white ceiling and a window behind the camera."""
    made = sv.Scene(name="bubbles")
    for number, (place, radius) in enumerate(BUBBLES):
        made.add(sv.shapes.sphere(radius, 96), film(number), place, name=f"bubble {number}")
    height = np.linspace(1, -1, 64)[:, None, None]
    made.environment = sv.Environment(np.broadcast_to(np.clip(0.25 + 0.75 * height, 0.05, 1), (64, 128, 3)))
    lamp = sv.Material(emissive=6, double_sided=True)
    made.add(sv.shapes.quad((-3, 3, 6), (1.1, 0, 0.5), (0, -1.6, 0)), lamp, name="window")
    dark = sv.Material(base_color=(0.002, 0.004, 0.01), specular=0)
    made.add(sv.shapes.quad((0, 0, -9), (30, 0, 0), (0, 20, 0)), dark, name="wall")
    made.camera = sv.Camera.look_at((0, -0.05, 3.2), (0, 0.1, 0), fov=27, ev100=-2.4)
    return made
