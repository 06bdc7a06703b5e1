"""An orthographic camera: parallel edges stay parallel.

`sv.Camera(orthographic_height=...)`, as architects and games use it; glTF's orthographic cameras are read as well.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import solari_vk as sv


def scene(assets: Path | None) -> sv.Scene:
    """A block of houses in isometric view, in the sun."""
    made = sv.Scene()
    ground = sv.Material(base_color=(0.35, 0.4, 0.3), roughness=0.9)
    made.add(sv.shapes.quad((0, 0, 0), (0, 0, 40), (40, 0, 0)), ground, name="ground")
    generator = np.random.default_rng(4)
    for x in range(-3, 4):
        for z in range(-3, 4):
            height = float(generator.uniform(0.3, 2.2))
            color = generator.uniform(0.3, 0.8, 3)
            box = sv.shapes.box((-0.35, 0, -0.35), (0.35, height, 0.35))
            made.add(box, sv.Material(base_color=color, roughness=0.6), (x, 0, z), name=f"house {x} {z}")
            if generator.random() < 0.2:
                lamp = sv.Material(emissive=(3e4, 2e4, 1e4))
                made.add(sv.shapes.sphere(0.08, 16), lamp, (x + 0.5, 0.25, z + 0.5), name=f"lamp {x} {z}")
    made.environment = sv.Sky((-0.6, 1, 0.55))
    made.camera = sv.Camera.look_at((8, 8, 8), (0, 0.6, 0), orthographic_height=8.0, ev100=14.0)
    return made
