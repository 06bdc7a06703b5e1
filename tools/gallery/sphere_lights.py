"""Sphere lights: point lights of the same intensity with a radius of 2, 10 and 25 cm, over a floor that shines."""

from __future__ import annotations

from pathlib import Path

import solari_vk as sv


def scene(assets: Path | None) -> sv.Scene:
    """A post below each lamp."""
    clay = sv.Material(base_color=(0.7, 0.7, 0.7), roughness=0.6)
    polished = sv.Material(base_color=(0.5, 0.5, 0.5), roughness=0.25, reflectance=1)
    made = sv.Scene(sv.Camera.look_at((0, 2.6, 5.8), (0.1, 0.7, 0), vertical_fov=0.75))
    made.add(sv.shapes.quad((0, 0, 0), (0, 0, 5), (5, 0, 0)), polished, name="floor")
    made.add(sv.shapes.quad((0, 2, -2.5), (5, 0, 0), (0, 2, 0)), clay, name="wall")
    for x, radius in ((-1.5, 0.02), (0.0, 0.1), (1.5, 0.25)):
        made.add(sv.shapes.box((-0.05, 0, -0.05), (0.05, 0.7, 0.05)), clay, (x, 0, 0.3))
        made.add(sv.PointLight((x + 0.45, 1.1, 0.5), intensity=3, radius=radius))
    return made
