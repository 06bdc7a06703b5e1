"""Point lights: three bulbs of a color each, without a radius, so that shadows are sharp."""

from __future__ import annotations

from pathlib import Path

import solari_vk as sv


def scene(assets: Path | None) -> sv.Scene:
    """Columns on a floor before a wall."""
    clay = sv.Material(base_color=(0.7, 0.7, 0.7), roughness=0.5)
    made = sv.Scene(sv.Camera.look_at((0, 2.4, 5.2), (0, 0.7, 0), vertical_fov=0.75))
    made.add(sv.shapes.quad((0, 0, 0), (0, 0, 5), (5, 0, 0)), clay, name="floor")
    made.add(sv.shapes.quad((0, 2, -2), (5, 0, 0), (0, 2, 0)), clay, name="wall")
    for x in (-1.5, -0.5, 0.5, 1.5):
        made.add(sv.shapes.box((-0.1, 0, -0.1), (0.1, 1.2, 0.1)), clay, (x, 0, -0.6))
    for place, color in (
        ((-1.8, 1.5, 0.8), (1, 0.3, 0.1)),
        ((0, 1.8, 0.6), (0.2, 1, 0.4)),
        ((1.8, 1.5, 0.8), (0.2, 0.4, 1)),
    ):
        made.add(sv.PointLight(place, intensity=8, color=color))
    return made
