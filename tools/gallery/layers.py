"""Clearcoat, sheen and anisotropy.

From the left: red paint without and with a clearcoat, cloth with sheen, and metal brushed in two directions.
"""

from __future__ import annotations

import math
from pathlib import Path

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, matte, place


def scene(assets: Path | None) -> sv.Scene:
    """Five balls on a gray floor."""
    made = sv.Scene()
    made.add(shapes.quad((0, 0, 0), (0, 0, 6), (6, 0, 0)), matte(0.3), name="floor")
    ball = shapes.sphere(0.5, 64)
    paint = {"base_color": (0.6, 0.03, 0.03), "perceptual_roughness": 0.6}
    metal = {"base_color": (0.9, 0.8, 0.6), "metallic": 1.0, "perceptual_roughness": 0.25, "anisotropy": 0.9}
    for x, fields in (
        (-2.2, paint),
        (-1.1, {**paint, "clearcoat": 1.0, "clearcoat_roughness": 0.05}),
        (0.0, {"base_color": (0.05, 0.05, 0.15), "sheen_color": (0.7, 0.7, 1.0), "sheen_roughness": 0.4}),
        (1.1, metal),
        (2.2, {**metal, "anisotropy_rotation": math.pi / 2}),
    ):
        made.add(ball, sv.Material(**fields), place(at=(x, 0.5, 0)))
    for x in (-2.0, 2.0):
        made.add(shapes.facing_quad((x, 3.0, 2.0), 0.5, (0, 0.5, 0)), lamp(25.0), name="lamp")
    made.camera = sv.Camera.look_at((0, 1.5, 5.9), (0, 0.5, 0), vertical_fov=0.75)
    return made
