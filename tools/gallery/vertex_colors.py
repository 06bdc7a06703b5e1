"""Vertex colors: they multiply the base color, as in scans without textures."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import solari_vk as sv
from solari_vk.scene import shapes


def scene(assets: Path | None) -> sv.Scene:
    """Two balls, a smooth and a metallic one, whose vertices have the colors of their directions."""
    made = sv.Scene(name="vertex colors")
    made.add(shapes.quad((0, 0, 0), (5, 0, 0), (0, 0, -5)), sv.Material(base_color=0.6, roughness=0.8))
    made.add(shapes.quad((0, 3.5, 0), (1, 0, 0), (0, 0, 1)), sv.Material(base_color=0.0, emissive=20_000.0))
    ball = shapes.sphere()
    colors = np.clip(0.5 + 0.5 * ball.normals, 0.05, 0.95) ** 2
    colored = sv.Mesh(ball.positions, ball.triangles, normals=ball.normals, colors=colors)
    for x, fields in ((-0.85, {"roughness": 0.6}), (0.85, {"roughness": 0.25, "metallic": 1.0})):
        placed = np.diag([0.75, 0.75, 0.75, 1.0])
        placed[:3, 3] = x, 0.75, 0
        made.add(colored, sv.Material(base_color=1.0, **fields), placed)
    made.camera = sv.Camera.look_at((0, 1.9, 4.0), (0, 0.65, 0), ev100=11.5)
    return made
