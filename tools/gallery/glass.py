"""Glass: solid, rough, colored by its volume, and a thin wall.

From the left: clear and rough solid balls, one whose volume colors light, and a bubble with a thin wall. The pane
behind them is thin as well and lets the lamp's light pass, tinted.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, matte, place


def scene(assets: Path | None) -> sv.Scene:
    """Four balls on a checkered floor, and a pane."""
    made = sv.Scene()
    squares = np.where(np.indices((16, 16)).sum(axis=0) % 2, 200, 60).astype(np.uint8)
    texture = sv.Texture(squares, magnification="nearest")
    floor = sv.Material(base_color_texture=texture, base_color=1.0, perceptual_roughness=0.8)
    made.add(shapes.quad((0, 0, 0), (0, 0, 4), (4, 0, 0)), floor, name="floor")
    made.add(shapes.quad((0, 2, -2.5), (4, 0, 0), (0, 2, 0)), matte((0.5, 0.55, 0.6)), name="wall")
    ball = shapes.sphere(0.5, 64)
    glass = {"transmission": 1.0, "base_color": 1.0, "perceptual_roughness": 0.0}
    for x, fields in (
        (-1.65, {"solid": True}),
        (-0.55, {"solid": True, "perceptual_roughness": 0.3}),
        (0.55, {"solid": True, "attenuation_color": (0.9, 0.25, 0.1), "attenuation_distance": 0.4}),
        (1.65, {}),
    ):
        made.add(ball, sv.Material(**{**glass, **fields}), place(at=(x, 0.5, 0)))
    pane = sv.Material(**{**glass, "base_color": (0.3, 0.7, 0.9)}, double_sided=True)
    made.add(shapes.quad((1.3, 1.0, -1.2), (0.7, 0, 0), (0, 1.0, 0)), pane, name="pane")
    made.add(shapes.facing_quad((2.5, 3.5, -1.8), 0.6, (0, 0, 0)), lamp(40.0), name="lamp")
    made.add(shapes.facing_quad((-2.5, 3.0, 2.5), 0.8, (0, 0.5, 0)), lamp(12.0), name="fill")
    made.camera = sv.Camera.look_at((0, 1.6, 4.6), (0, 0.6, 0), vertical_fov=0.75)
    return made
