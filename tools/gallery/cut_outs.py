"""Cut-outs: glTF's alpha mode MASK.

Leaves are squares with an alpha texture. Rays of all kinds pass where its alpha is below the cutoff.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import solari_vk as sv
from solari_vk.scene import shapes


def leaf(size: int = 128) -> np.ndarray:
    """The pixels of a leaf, transparent around it."""
    v, u = (np.mgrid[:size, :size] + 0.5) / size * 2 - 1
    width = 0.55 * np.sqrt(np.clip(1 - v**2, 0, 1)) * (1 - 0.35 * v)
    pixels = np.zeros((size, size, 4), np.uint8)
    vein = (np.abs(u) < 0.03) | (np.abs((v + np.abs(u)) % 0.3 - 0.15) < 0.015)
    pixels[..., :3] = np.where(vein[..., None], (150, 190, 90), (60, 130, 40))
    pixels[..., 3] = 255 * (np.abs(u) < width)
    return pixels


def scene(assets: Path | None) -> sv.Scene:
    """A bush of leaves before a wall, in the light of the sun and a window."""
    rng = np.random.default_rng(4)
    made = sv.Scene(sv.DirectionalLight((0.5, -1.0, -0.6), illuminance=50_000), name="cut-outs")
    made.add(shapes.quad((0, 0, 0), (6, 0, 0), (0, 0, -6)), sv.Material(base_color=(0.6, 0.5, 0.4), roughness=0.9))
    made.add(shapes.quad((0, 3, -1.6), (6, 0, 0), (0, 3, 0)), sv.Material(base_color=0.8, roughness=0.9))
    window = sv.Material(base_color=0.0, emissive=4000.0, double_sided=True)
    made.add(shapes.quad((-3, 3, 3), (0.7, 0, 0.7), (0, 1, 0)), window)
    material = sv.Material(base_color_texture=leaf(), alpha_mode="mask", double_sided=True, roughness=0.5)
    square = shapes.quad((0, 0.5, 0), (0.5, 0, 0), (0, 0.5, 0))
    for _ in range(90):
        angle = rng.uniform(0, 2 * np.pi)
        tilt = rng.uniform(0.2, 1.2)
        size = rng.uniform(0.5, 1.0)
        along = np.array([np.cos(angle) * np.sin(tilt), np.cos(tilt), np.sin(angle) * np.sin(tilt)])
        side = np.cross(along, rng.normal(size=3))
        side /= np.linalg.norm(side)
        placed = np.eye(4)
        placed[:3, :3] = np.stack([side, along, np.cross(side, along)], axis=1) * size
        placed[:3, 3] = rng.uniform((-0.25, 0.05, -0.25), (0.25, 0.55, 0.25))
        made.add(square, material, placed)
    made.camera = sv.Camera.look_at((0.6, 1.4, 3.4), (0, 0.75, 0), ev100=13.0)
    return made
