"""Luminaires: the light of photometric files (IES LM-63) on a wall.

From the left: a narrow downlight, a wide one that is darkest straight below, and one whose beam leans towards the wall
and has a second, weaker one. Files are read by `PointLight(ies="lamp.ies")`; these profiles are made of arrays.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import solari_vk as sv


def scene(assets: Path | None) -> sv.Scene:
    """Three luminaires, 40 cm before a wall."""
    clay = sv.Material(base_color=(0.5, 0.5, 0.5), specular=0)
    made = sv.Scene(sv.Camera.look_at((0, 1.6, 4.6), (0, 1.3, 0), vertical_fov=0.62, ev100=2.5))
    made.add(sv.shapes.quad((0, 0, 2), (0, 0, 3), (4, 0, 0)), clay, name="floor")
    made.add(sv.shapes.quad((0, 1.5, -1), (4, 0, 0), (0, 1.5, 0)), clay, name="wall")
    vertical, around = np.arange(0, 91, 2.5), np.arange(0, 361, 10)

    def beam(center: float, width: float, candelas: float) -> np.ndarray:
        return candelas * np.exp(-(((vertical - center) / width) ** 2)) * (vertical < 85)

    towards_wall = np.maximum(np.cos(np.radians(around)), 0)[:, None] ** 4
    leaning = towards_wall * beam(35, 12, 300) + beam(0, 8, 250)
    profiles = (
        sv.LightProfile(vertical, [0], [beam(0, 22, 260)]),
        sv.LightProfile(vertical, [0], [beam(48, 14, 170) + beam(0, 30, 40)]),
        sv.LightProfile(vertical, around, leaning),
    )
    for x, profile, kelvin in zip((-1.4, 0, 1.4), profiles, (3500, 5500, 4000), strict=True):
        made.add(sv.PointLight((x, 2.6, -0.6), ies=profile, direction=(0, -1, 0), horizontal=(0, 0, -1), kelvin=kelvin))
    made.add(sv.shapes.sphere(0.3), clay, (0.7, 0.3, -0.4))
    return made
