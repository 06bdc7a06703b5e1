"""A room at dusk with 40 lamps.

The sun has set behind the window. Each paper lantern is a sphere with an emissive material; the renderer finds those
that matter at a surface by its tree of lights.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

import solari_vk as sv

SAMPLES = 64
LAMPS = 40


def planks() -> np.ndarray:
    """A wooden floor, (height, width, 3) in sRGB: boards of one color each, with grain and seams."""
    random = np.random.default_rng(2)
    rows, columns = np.mgrid[0:1024, 0:1024]
    board = columns // 64
    length = (rows + random.integers(0, 1024, 16)[board]) // 400
    tone = random.uniform(0.75, 1.1, (16, 8))[board, length % 8]
    grain = 1 + 0.06 * np.sin(columns * 0.9 + 6 * np.sin(rows / 90 + board))
    seam = np.where((columns % 64 < 2) | ((rows + random.integers(0, 1024, 16)[board]) % 400 < 2), 0.45, 1.0)
    return np.uint8(np.clip((tone * grain * seam)[..., None] * (122, 82, 52), 0, 255))


def scene(assets: Path) -> sv.Scene:
    """A hall with a window over the whole far wall, and lanterns that hang from its ceiling."""
    made = sv.Scene(name="dusk")
    plaster = sv.Material(base_color=(0.5, 0.5, 0.5))
    frame = sv.Material(base_color=(0.04, 0.035, 0.03), roughness=0.4)
    floor = sv.Material(base_color_texture=planks(), roughness=0.14)
    made.add(sv.shapes.plane(12, 16), floor, name="floor")
    for low, high in (
        ((-6.2, 0, -8), (-6, 5, 8)),
        ((6, 0, -8), (6.2, 5, 8)),
        ((-6, 0, 8), (6, 5, 8.2)),
        ((-6, 5, -8), (6, 5.2, 8)),
    ):
        made.add(sv.shapes.box(low, high), plaster)
    for x in np.linspace(-6, 6, 7):
        made.add(sv.shapes.box((x - 0.06, 0, -8.1), (x + 0.06, 5, -7.9)), frame)
    for y in (0.06, 3.4, 4.94):
        made.add(sv.shapes.box((-6, y - 0.06, -8.1), (6, y + 0.06, -7.9)), frame)
    made.add(sv.Portal((0, 2.5, -8), (6, 0, 0), (0, 2.5, 0)))

    random = np.random.default_rng(11)
    paper = sv.Material(base_color=0.8, emissive=50 * sv.kelvin(2700))
    for number in range(LAMPS):
        x = -4.9 + 1.4 * (number % 8) + random.uniform(-0.35, 0.35)
        z = -6.4 + 2.3 * (number // 8) + random.uniform(-0.6, 0.6)
        y = 3.1 + 0.55 * math.sin(0.9 * x) * math.cos(0.7 * z) + random.uniform(-0.3, 0.3)
        radius = random.uniform(0.10, 0.21)
        made.add(sv.shapes.sphere(radius, 24), paper, (x, y, z), name=f"lantern {number}")
        made.add(sv.shapes.box((x - 0.006, y, z - 0.006), (x + 0.006, 5, z + 0.006)), frame)

    bench, cushion = (
        sv.Material(base_color=(0.16, 0.09, 0.05), roughness=0.3),
        sv.Material(base_color=(0.08, 0.16, 0.2), sheen_color=0.4, sheen_roughness=0.5),
    )
    made.add(sv.shapes.box((-3.4, 0, -2.6), (-0.6, 0.32, -1.6)), bench)
    made.add(sv.shapes.box((-3.35, 0.32, -2.55), (-2.02, 0.5, -1.65)), cushion)
    made.add(sv.shapes.box((-1.98, 0.32, -2.55), (-0.65, 0.5, -1.65)), cushion)
    made.add(sv.shapes.cylinder(0.6, 0.06), bench, (1.6, 0.5, -1.4))
    made.add(sv.shapes.cylinder(0.05, 0.5), frame, (1.6, 0.25, -1.4))
    made.add(sv.shapes.cylinder(0.35, 0.04), frame, (1.6, 0.02, -1.4))
    glazed = sv.Material(base_color=(0.5, 0.12, 0.05), roughness=0.15, clearcoat=1)
    made.add(sv.shapes.sphere(0.2, 48), glazed, (1.42, 0.73, -1.5))
    made.add(sv.shapes.cylinder(0.07, 0.25), glazed, (1.42, 0.98, -1.5))
    steel = sv.Material(base_color=0.9, metallic=1, roughness=0.03)
    made.add(sv.shapes.sphere(0.11, 48), steel, (1.85, 0.64, -1.15))
    made.add(
        sv.shapes.torus(0.7, 0.16, 96),
        steel,
        np.array([[1, 0, 0, 3.6], [0, 0, -1, 1.12], [0, 1, 0, -3.2], [0, 0, 0, 1]], float),
        name="sculpture",
    )
    made.add(sv.shapes.box((3.2, 0, -3.6), (4, 0.28, -2.8)), plaster)

    made.environment = sv.Sky((-0.25, -0.035, -1.0), intensity=0.03)
    made.camera = sv.Camera.look_at((0.4, 1.45, 5.4), (0.05, 1.85, -3), fov=50, ev100=2.6)
    return made
