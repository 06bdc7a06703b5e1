"""Simpler meshes for rays.

Rays hit coarse balls: in the mirror, in shadows, and everywhere in the path tracer's picture on the left. The realtime
renderer rasterizes the fine ones that the camera sees.
"""

from __future__ import annotations

from pathlib import Path

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, matte, place


def scene(assets: Path | None) -> sv.Scene:
    """Three balls with ray meshes before a mirror."""
    made = sv.Scene()
    made.add(shapes.quad((0, 0, 0), (0, 0, 6), (6, 0, 0)), matte(0.4), name="floor")
    mirror = sv.Material(base_color=0.95, metallic=1.0, perceptual_roughness=0.0)
    made.add(shapes.facing_quad((0, 1.2, -1.6), 1.9, (0, 1.2, 0)), mirror, name="mirror")
    fine, coarse = shapes.sphere(0.5, 64), shapes.sphere(0.5, 7)
    for x, color in ((-1.2, (0.6, 0.1, 0.05)), (0.0, (0.1, 0.4, 0.1)), (1.2, (0.1, 0.15, 0.5))):
        ball = sv.Instance(fine, matte(color), place(at=(x, 0.5, 0)), ray_mesh=coarse)
        made.add(ball)
    made.add(shapes.facing_quad((2.0, 3.0, 2.5), 1.5, (0, 0.5, 0)), lamp(6.0), name="lamp")
    made.camera = sv.Camera.look_at((0.6, 1.7, 4.6), (0, 0.7, 0), vertical_fov=0.75)
    return made
