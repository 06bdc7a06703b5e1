"""Depth of field: a thin lens, focused on the second of five balls.

Each realtime frame sees through one point of the lens, and the mean of frames is the picture.
"""

from __future__ import annotations

from pathlib import Path

import solari_vk as sv


def scene(assets: Path | None) -> sv.Scene:
    """Balls in a row, away from the camera, on a floor under a lamp."""
    made = sv.Scene()
    made.add(sv.shapes.quad((0, 0, -2), (0, 0, 6), (6, 0, 0)), sv.Material(base_color=0.4, roughness=0.8), name="floor")
    made.add(sv.shapes.quad((0, 4, 0), (1.5, 0, 0), (0, 0, 1.5)), sv.Material(emissive=(12, 11, 10)), name="lamp")
    colors = ((0.8, 0.15, 0.1), (0.85, 0.6, 0.1), (0.15, 0.6, 0.2), (0.1, 0.35, 0.8), (0.5, 0.15, 0.6))
    for number, color in enumerate(colors):
        at = (-1.4 + 0.7 * number, 0.4, 1.6 - 1.3 * number)
        made.add(sv.shapes.sphere(0.4, 48), sv.Material(base_color=color, roughness=0.25), at, name=f"ball {number}")
    made.camera = sv.Camera.look_at((-1.2, 1.3, 5.4), (0.0, 0.35, -0.6), vertical_fov=0.5, ev100=0.0)
    made.camera.update(focus_distance=5.0, aperture=0.3)
    return made
