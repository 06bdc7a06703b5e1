"""A fisheye lens: 180 degrees in a circle.

`sv.Camera(projection="fisheye")`, equidistant here; OpenCV's distortion may be added. Beyond the circle is nothing.
"""

from __future__ import annotations

import math
from pathlib import Path

import solari_vk as sv


def scene(assets: Path | None) -> sv.Scene:
    """A room with pillars, tiles and a lamp, seen from its middle."""
    made = sv.Scene()
    room = sv.shapes.box((-3, 0, -3), (3, 2.6, 3), inward=True)
    made.add(room, sv.Material(base_color=(0.7, 0.68, 0.6)), name="room")
    for x in range(-5, 6):
        for z in range(-5, 6):
            if (x + z) % 2 == 0:
                tile = sv.shapes.quad((0.5 * x, 0.001, 0.5 * z), (0, 0, 0.25), (0.25, 0, 0))
                made.add(tile, sv.Material(base_color=(0.25, 0.3, 0.35), roughness=0.3), name=f"tile {x} {z}")
    for number in range(10):
        angle = math.tau * number / 10
        color = [(0.8, 0.2, 0.15), (0.2, 0.5, 0.8), (0.85, 0.65, 0.2)][number % 3]
        at = (2.1 * math.sin(angle), 0.9, 2.1 * math.cos(angle))
        paint = sv.Material(base_color=color, roughness=0.4)
        made.add(sv.shapes.cylinder(0.16, 1.8, 24), paint, at, name=f"pillar {number}")
    lamp = sv.shapes.quad((0, 2.59, 0), (0.7, 0, 0), (0, 0, 0.7))
    made.add(lamp, sv.Material(emissive=(14, 13, 12)), name="lamp")
    made.camera = sv.Camera.look_at((0.4, 1.2, 0.6), (0, 1.15, -2), ev100=1.0)
    made.camera.update(projection="fisheye", vertical_fov=math.pi, image_circle=math.pi)
    return made
