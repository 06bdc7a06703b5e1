"""Motion blur: a wheel turns and a ball passes while the shutter is open.

The path tracer exposes the scene at many times. A realtime frame shows one of them, and the picture is their mean.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import solari_vk as sv


def scene(assets: Path | None) -> sv.Scene:
    """A wheel of spokes and a ball before a wall, under a lamp."""
    made = sv.Scene()
    wall = sv.Material(base_color=(0.5, 0.5, 0.55), roughness=0.9)
    made.add(sv.shapes.quad((0, 0, 0), (0, 0, 3), (4, 0, 0)), wall, name="floor")
    made.add(sv.shapes.quad((0, 2, -1.5), (4, 0, 0), (0, 2, 0)), wall, name="wall")
    made.add(sv.shapes.quad((0, 3.5, 1), (0.8, 0, 0), (0, 0, 0.8)), sv.Material(emissive=(22, 21, 20)), name="lamp")
    for spoke in range(8):
        color = (0.85, 0.2, 0.1) if spoke % 2 else (0.9, 0.8, 0.6)
        shape = sv.shapes.box((-0.06, 0.15, -0.05), (0.06, 0.85, 0.05))
        made.add(shape, sv.Material(base_color=color), name=f"spoke {spoke}")
    ball = sv.Material(base_color=(0.1, 0.35, 0.8), roughness=0.15)
    made.add(sv.shapes.sphere(0.28, 48), ball, name="ball")
    made.camera = sv.Camera.look_at((0.3, 1.4, 4.2), (0.3, 0.95, 0), vertical_fov=0.65, ev100=0.3)
    pose(made, 0.5)
    return made


def pose(made: sv.Scene, seconds: float) -> None:
    """The scene at a time of the exposure, from 0 to 1."""
    for spoke in range(8):
        angle = spoke * math.pi / 4 + 0.35 * seconds
        turn = [
            [math.cos(angle), -math.sin(angle), 0, -0.6],
            [math.sin(angle), math.cos(angle), 0, 1.0],
            [0, 0, 1, -0.4],
            [0, 0, 0, 1],
        ]
        made.instances[f"spoke {spoke}"].transform = turn
    made.instances["ball"].position = (0.85 + 0.6 * seconds, 0.28 + 0.5 * math.sin(math.pi * seconds), 0.4)


def exposure(made: sv.Scene) -> dict[str, Any]:
    """The arguments of `render`."""
    return {"shutter": sv.Shutter(close=1.0, time_samples=64), "pose": lambda seconds: pose(made, seconds)}
