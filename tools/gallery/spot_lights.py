"""Spotlights: cones with a hard edge, a soft edge, and a soft edge with soft shadows from a radius of 8 cm."""

from __future__ import annotations

from pathlib import Path

import solari_vk as sv


def scene(assets: Path | None) -> sv.Scene:
    """A ball in each of three cones, before a wall."""
    clay = sv.Material(base_color=(0.7, 0.7, 0.7), roughness=0.5)
    made = sv.Scene(sv.Camera.look_at((0, 2.2, 5.4), (0, 0.8, 0), vertical_fov=0.75))
    made.add(sv.shapes.quad((0, 0, 0), (0, 0, 5), (5, 0, 0)), clay, name="floor")
    made.add(sv.shapes.quad((0, 2, -1.5), (5, 0, 0), (0, 2, 0)), clay, name="wall")
    ball = sv.shapes.sphere(0.3)
    lamps = ((-1.5, 0.37, 0.0, (1, 0.6, 0.3)), (0.0, 0.1, 0.0, (1, 1, 1)), (1.5, 0.1, 0.08, (0.4, 0.6, 1)))
    for x, inner, radius, color in lamps:
        made.add(ball, clay, (x, 0.3, 0))
        made.add(sv.SpotLight((x, 2.9, 1.2), (0, -1, -0.4), intensity=60, color=color, radius=radius,
                              inner_cone_angle=inner, outer_cone_angle=0.38))  # fmt: skip
    return made
