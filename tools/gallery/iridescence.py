"""Iridescence: thin films, whose colors are those of light that interferes with itself.

From the left: a soap bubble, whose film is 150 nm thick at the top and 750 nm at the bottom, oil on black paint, and
anodized metal, whose oxide is thinner at the top.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import solari_vk as sv
from solari_vk.scene.lights.environment import directions


def scene(assets: Path | None) -> sv.Scene:
    """Three balls before darkness, in the light of a bright sky behind the camera."""
    made = sv.Scene(sv.Camera.look_at((0, 0, 5), (0, 0, 0), vertical_fov=0.62))
    x, y, z = np.moveaxis(directions(32, 64), -1, 0)
    light = 0.008 + 9 * np.maximum(0.8 * z + 0.5 * y - 0.15 * x, 0) ** 2
    made.add(sv.Environment(np.stack([light, light, light], axis=-1)))
    downwards = np.linspace(0, 255, 256).astype(np.uint8)[:, None, None].repeat(3, axis=2)
    films = {"iridescence": 1.0, "iridescence_thickness_texture": downwards}
    bubble = {"transmission": 1.0, "base_color": 1.0, "ior": 1.0, "roughness": 0.15}
    oil = {"base_color": 0.01, "roughness": 0.05}
    metal = {"base_color": (0.2, 0.2, 0.2), "metallic": 1.0, "roughness": 0.2}
    ball = sv.shapes.sphere(0.62, 96)
    for at, fields, ior, thickness in ((-1.4, bubble, 1.33, (150, 750)), (0.0, oil, 1.8, (150, 600)),
                                       (1.4, metal, 2.2, (60, 400))):  # fmt: skip
        made.add(ball, sv.Material(**fields, **films, iridescence_ior=ior, iridescence_thickness=thickness), (at, 0, 0))
    return made
