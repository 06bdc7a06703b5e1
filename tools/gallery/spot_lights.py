"""Spotlights: cones with a hard edge, a soft edge, and a soft edge with soft shadows from a radius of 8 cm."""

from __future__ import annotations

from pathlib import Path

import solari_vk as sv


def scene(assets: Path) -> sv.Scene:
    """Three works on plinths before a wall, each in a cone."""
    made = sv.Scene(sv.Camera.look_at((0, 1.75, 5.2), (0, 1.15, -0.6), fov=34, ev100=0.6))
    wall = sv.Material(base_color=(0.5, 0.48, 0.46), roughness=0.9)
    made.add(
        sv.shapes.quad((0, 0, 0), (0, 0, 6), (8, 0, 0)), sv.Material(base_color=0.25, roughness=0.25), name="floor"
    )
    made.add(sv.shapes.quad((0, 3, -1.4), (8, 0, 0), (0, 3, 0)), wall, name="wall")
    clay = sv.Material(base_color=(0.55, 0.16, 0.07), roughness=0.35)
    marble, glazed = sv.Material(base_color=0.8, roughness=0.3), sv.Material(base_color=(0.05, 0.25, 0.4), clearcoat=1)
    upright = [[1, 0, 0, 0], [0, 0, -1, 1.36], [0, 1, 0, 0], [0, 0, 0, 1]]
    works = (
        (sv.shapes.sphere(0.32, 64), marble, (-1.9, 1.22, 0)),
        (sv.shapes.torus(0.32, 0.12, 96), clay, upright),
        (sv.shapes.cone(0.3, 0.75, 6), glazed, (1.9, 1.275, 0)),
    )
    lamps = ((-1.9, 0.3, 0.0, 2700), (0.0, 0.1, 0.0, 4000), (1.9, 0.1, 0.08, 7000))
    for (mesh, material, place), (x, inner, radius, kelvin) in zip(works, lamps, strict=True):
        made.add(sv.shapes.box((x - 0.28, 0, -0.28), (x + 0.28, 0.9, 0.28)), wall, name="plinth")
        made.add(mesh, material, place)
        made.add(
            sv.SpotLight(
                (x, 4.2, 2.2),
                (0, -3.1, -2.4),
                intensity=90,
                kelvin=kelvin,
                radius=radius,
                inner_cone_angle=inner,
                outer_cone_angle=0.31,
            )
        )
    return made
