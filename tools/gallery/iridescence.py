"""Iridescence: thin films, whose colors are those of light that interferes with itself.

From the left: a soap bubble, whose film is 150 nm thick at the top and 750 nm at the bottom, oil on black paint, and
anodized metal whose oxide grows from the left to the right.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, matte, place


def scene(assets: Path | None) -> sv.Scene:
    """Three balls under large soft lamps."""
    made = sv.Scene(sv.Camera.look_at((0, 1.5, 4.4), (0, 0.62, 0), vertical_fov=0.65))
    made.add(shapes.quad((0, 0, 0), (0, 0, 6), (6, 0, 0)), matte(0.1), name="floor")
    made.add(shapes.quad((0, 3, -4), (6, 0, 0), (0, 3, 0)), matte(0.06), name="wall")
    downwards = np.linspace(0, 255, 256).astype(np.uint8)[:, None, None].repeat(3, axis=2)
    bubble = {"transmission": 1.0, "base_color": 1.0, "ior": 1.0, "iridescence_ior": 1.33,
              "iridescence_thickness": (150, 750), "iridescence_thickness_texture": downwards}  # fmt: skip
    oil = {"base_color": 0.01, "iridescence_ior": 1.45, "iridescence_thickness": (0, 420)}
    metal = {"base_color": (0.6, 0.58, 0.55), "metallic": 1.0, "roughness": 0.15, "iridescence_ior": 2.2,
             "iridescence_thickness": (40, 260), "iridescence_thickness_texture": downwards.transpose(1, 0, 2)}  # fmt: skip
    ball = shapes.sphere(0.6, 96)
    for x, fields in ((-1.4, bubble), (0.0, oil), (1.4, metal)):
        made.add(ball, sv.Material(**{"roughness": 0.0, **fields}, iridescence=1.0), place(at=(x, 0.62, 0)))
    for at, half, radiance in (((-3.5, 3.0, 1.5), 1.4, 5.0), ((3.5, 3.0, 2.0), 1.4, 5.0), ((0, 4.5, -1.0), 1.5, 4.0)):
        made.add(shapes.facing_quad(at, half, (0, 0.6, 0)), lamp(radiance), name="lamp")
    return made
