"""A fox, mid-run.

The camera keeps up with it, so its body is sharp, its legs are blurred by their own speed and the meadow by the fox's:
`tracer.render(shutter=..., pose=...)` plays the file's clip while the shutter is open. The Fox of the Khronos sample
assets is by PixelMannen (CC0), rigged by tomkranis and made a glTF by AsoboStudio and scurest (CC BY 4.0).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

import solari_vk as sv

SAMPLES = 64
SPEED = 420.0  # cm/s
SHUTTER = 1 / 40  # s
START = 0.32  # s of the clip "Run"


def cones(places: np.ndarray, radii: np.ndarray, heights: np.ndarray, colors: np.ndarray, sides: int) -> sv.Mesh:
    """Cones without a base as one mesh; places (N, 3) are the middles of the bases, colors (N, 3) are linear."""
    turn = np.arange(sides) * 2 * math.pi / sides
    ring = np.stack([np.cos(turn), np.zeros(sides), -np.sin(turn)], axis=1)
    base = places[:, None] + radii[:, None, None] * ring
    tip = places + heights[:, None] * (0, 1, 0)
    points = np.stack([base, np.roll(base, -1, axis=1), np.broadcast_to(tip[:, None], base.shape)], axis=2).reshape(
        -1, 3
    )
    return sv.Mesh(points, np.arange(len(points)).reshape(-1, 3), colors=np.repeat(colors, 3 * sides, axis=0))


def scene(assets: Path) -> sv.Scene:
    """The fox on a meadow with trees; lengths are centimeters, as in its file."""
    made = sv.load(assets / "Fox" / "Fox.glb")
    random = np.random.default_rng(4)
    count = 26_000
    grass = random.uniform((-1500, 0, -1500), (500, 0, 1500), (count, 3))
    tone = random.uniform(0.6, 1.3, (count, 1)) * (0.13, 0.19, 0.035)
    tone[random.uniform(size=count) < 0.03] = (0.7, 0.55, 0.15)
    blades = cones(grass, random.uniform(0.8, 2.2, count), random.uniform(3, 11, count), tone, 3)
    made.add(sv.shapes.plane(60_000), sv.Material(base_color=(0.09, 0.12, 0.03)), name="soil")
    made.add(blades, sv.Material(double_sided=True), name="meadow: grass")
    for _ in range(60):
        x, z = random.uniform(-4200, -330), random.uniform(-3500, 2600)
        size = random.uniform(0.8, 1.6)
        heights = np.array([260, 230, 190]) * size
        layers = np.stack([(x, y * size, z) for y in (60, 170, 280)])
        green = np.tile(random.uniform(0.7, 1.2) * np.array((0.05, 0.13, 0.05)), (3, 1))
        leaves = cones(layers, np.array([110, 85, 58]) * size, heights, green, 9)
        made.add(leaves, sv.Material(double_sided=True), name="meadow: leaves")
        bark = sv.Material(base_color=(0.1, 0.06, 0.03))
        made.add(sv.shapes.cylinder(16 * size, 80 * size, 9), bark, (x, 40 * size, z), name="meadow: trunk")
    made.environment = sv.Sky((0.8, 0.4, 0.7), turbidity=3)
    made.camera = sv.Camera.look_at((215, 38, 150), (-5, 44, 2), fov=29, ev100=13.4)
    made.camera.focus_on((0, 45, 20), 4.0)
    return made


def exposure(made: sv.Scene) -> dict[str, Any]:
    """The arguments of the path tracer: the fox stays in the picture, and the meadow passes."""
    meadow = made.group(*(instance for instance in made if instance.name.startswith("meadow")))

    def pose(seconds: float) -> None:
        made.animate(START + seconds, "Run")
        meadow.position = (0, 0, -SPEED * seconds)

    return {"shutter": sv.Shutter(close=SHUTTER, time_samples=32), "pose": pose}
