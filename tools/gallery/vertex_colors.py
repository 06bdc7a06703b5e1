"""Vertex colors: they multiply the base color, as in scans and maps without textures."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import solari_vk as sv

SIDE = 384
LEVELS = np.array([-1, 0.0, 0.05, 0.12, 0.5, 0.85, 1.05, 2])  # heights in meters
COLORS = np.array([(0.5, 0.42, 0.28), (0.55, 0.47, 0.3), (0.5, 0.42, 0.25), (0.12, 0.2, 0.05), (0.1, 0.16, 0.06),
                   (0.25, 0.2, 0.17), (0.85, 0.87, 0.9), (0.9, 0.9, 0.92)])  # fmt: skip


def island() -> sv.Mesh:
    """A mountain of summed noise in the sea, 8 m wide; each vertex has the color of its height."""
    random = np.random.default_rng(21)
    x, z = np.meshgrid(np.linspace(-4, 4, SIDE), np.linspace(-4, 4, SIDE))
    height = np.zeros_like(x)
    for octave in range(1, 8):
        for _ in range(3):
            wave = random.normal(size=2) * 0.55 * 1.9**octave / 1.9
            phase = random.uniform(0, 2 * np.pi)
            height += (1 - 2 * abs(np.sin(x * wave[0] + z * wave[1] + phase))) * 0.52**octave * 0.5
    height = (1.45 + height) * np.exp(-((x / 2.3) ** 2 + (z / 1.9) ** 2)) - 0.22
    colors = np.stack([np.interp(height, LEVELS, channel) for channel in COLORS.T], axis=-1)
    number = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    # The corners of each square of the grid, in two triangles.
    a = number[:-1, :-1]
    b = number[1:, :-1]
    c = number[:-1, 1:]
    d = number[1:, 1:]
    triangles = np.stack([a, b, c, c, b, d], axis=-1).reshape(-1, 3)
    return sv.Mesh(np.stack([x, height, z], axis=-1).reshape(-1, 3), triangles, colors=colors.reshape(-1, 3))


def scene(assets: Path) -> sv.Scene:
    """The island in a calm sea, under a low sun."""
    made = sv.Scene(name="vertex colors")
    made.add(island(), sv.Material(roughness=0.9), name="island")
    made.add(sv.shapes.plane(400), sv.Material(base_color=(0.01, 0.05, 0.07), roughness=0.12), name="sea")
    made.environment = sv.Sky((0.9, 0.35, 0.5))
    made.camera = sv.Camera.look_at((2.6, 1.5, 6.2), (-0.1, 0.35, 0), fov=30, auto_exposure=True)
    return made
