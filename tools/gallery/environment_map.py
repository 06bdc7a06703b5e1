"""An environment map: a picture of all directions lights the scene, and mirrors and the camera see it.

The balls are rough, glossy and smooth metal, and white paint. The map is a photograph where one is given, otherwise it
is the sky.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import solari_vk as sv


def scene(assets: Path | None) -> sv.Scene:
    """Four balls in a row."""
    made = sv.Scene(sv.Camera.look_at((0, 0.8, 6), (0, 0, 0), vertical_fov=0.65))
    metal = np.array((0.95, 0.8, 0.6))
    for x, color, metallic, roughness in (
        (-2.1, metal, 1.0, 0.0),
        (-0.7, metal, 1.0, 0.25),
        (0.7, metal, 1.0, 0.6),
        (2.1, (0.9, 0.9, 0.9), 0.0, 0.5),
    ):
        paint = sv.Material(base_color=color, metallic=metallic, roughness=roughness)
        made.add(sv.shapes.sphere(0.6, 48), paint, (x, 0, 0))
    maps = sorted((assets / "hdri").glob("*.hdr")) if assets else []
    if maps:
        made.environment = sv.Environment(maps[0], rotation=2.0)
        made.camera.ev100 = 0.0
    else:
        made.environment = sv.Sky((1.0, 0.6, 0.5))
        made.camera.ev100 = 14.0
    return made
