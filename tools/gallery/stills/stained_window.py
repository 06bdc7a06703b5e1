"""Light through stained glass.

Each window is one rectangle of thin glass whose base color is a picture: light that passes takes the colors of the
panes, on floor and pillars too, and the lead between them stops it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import solari_vk as sv

SAMPLES = 64
PALETTE = np.array([(0.75, 0.04, 0.03), (0.95, 0.55, 0.05), (0.04, 0.18, 0.75), (0.05, 0.45, 0.2), (0.45, 0.06, 0.55),
                    (0.85, 0.78, 0.5), (0.05, 0.45, 0.7)])  # fmt: skip
HIGH, WIDE = 768, 288  # texels of a window, twice as high as wide and more


def window(seed: int) -> sv.Material:
    """A pointed arch of panes, a cell of Voronoi's each, under a rose; outside the arch is stone."""
    random = np.random.default_rng(seed)
    y, x = np.mgrid[0:HIGH, 0:WIDE] / WIDE  # y from the top, x from 0 to 1
    seeds = np.stack([random.uniform(0, 1, 130), random.uniform(0, HIGH / WIDE, 130)], axis=1)
    angle = np.arange(12) * np.pi / 6
    rose = np.array((0.5, 0.75)) + 0.27 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    seeds = seeds[np.hypot(*(seeds - (0.5, 0.75)).T) > 0.36]
    seeds = np.concatenate([seeds, rose, [(0.5, 0.75)]])
    colors = PALETTE[random.integers(0, len(PALETTE), len(seeds))]
    colors[-13:-1] = PALETTE[[0, 1] * 6]
    colors[-1] = PALETTE[2]
    distances = np.hypot(x[..., None] - seeds[:, 0], y[..., None] - seeds[:, 1])
    nearest = np.argsort(distances, axis=-1)[..., :2]
    first, second = np.take_along_axis(distances, nearest, axis=-1).transpose(2, 0, 1)
    lead = (second - first < 0.022) | (abs(np.hypot(x - 0.5, y - 0.75) - 0.36) < 0.015)
    inside = (y > 0.85) | ((np.hypot(x - 1, y - 0.85) < 0.97) & (np.hypot(x, y - 0.85) < 0.97))
    inside &= (x > 0.03) & (x < 0.97) & (y < HIGH / WIDE - 0.03)
    glass = inside & ~lead
    color = np.where(glass[..., None], colors[nearest[..., 0]], np.where(inside[..., None], 0.02, 0.5))
    picture = np.uint8(255 * color ** (1 / 2.2))
    clear = np.uint8(255 * glass)[..., None].repeat(3, axis=-1)
    return sv.Material(
        base_color_texture=picture, transmission=1, transmission_texture=clear, roughness=0, double_sided=True
    )


def scene(assets: Path) -> sv.Scene:
    """A nave with three windows in its left wall."""
    made = sv.Scene(name="stained window")
    stone = sv.Material(base_color=(0.55, 0.5, 0.43), roughness=0.9)
    rows, columns = np.indices((16, 8))
    tiles = np.where(((rows + columns) % 2)[..., None], (150, 140, 125), (95, 85, 78)).astype(np.uint8)
    checks = sv.Texture(image=tiles, magnification="nearest", minification="nearest", mipmaps=False)
    made.add(sv.shapes.plane(8, 16), sv.Material(base_color_texture=checks, roughness=0.25), (0, 0, -6))
    made.add(sv.shapes.box((4, 0, -14), (4.5, 9, 2)), stone)
    made.add(sv.shapes.box((-4.5, 9, -14), (4.5, 9.5, 2)), stone)
    made.add(sv.shapes.box((-4, 0, -14.5), (4, 9, -14)), stone)
    made.add(sv.shapes.box((-4.5, 0, 2), (4.5, 9, 2.5)), stone)
    edge = 2.0
    for number, z in enumerate((-2.2, -6.4, -10.6)):
        made.add(sv.shapes.box((-4.5, 0, z + 1.05), (-4, 9, edge)), stone)
        made.add(sv.shapes.box((-4.5, 0, z - 1.05), (-4, 1.6, z + 1.05)), stone)
        made.add(sv.shapes.box((-4.5, 7.2, z - 1.05), (-4, 9, z + 1.05)), stone)
        made.add(sv.shapes.quad((-4.25, 4.4, z), (0, 0, -1.05), (0, -2.8, 0)), window(number))
        edge = z - 1.05
    made.add(sv.shapes.box((-4.5, 0, -14), (-4, 9, edge)), stone)
    for z in (-0.2, -4.3, -8.5, -12.7):
        for x in (-3.4, 3.4):
            made.add(sv.shapes.cylinder(0.42, 9, 48), stone, (x, 4.5, z))
            made.add(sv.shapes.cylinder(0.56, 0.5, 48), stone, (x, 0.25, z))
    made.add(sv.shapes.box((-0.9, 0, -12.6), (0.9, 1.0, -11.8)), stone, name="altar")
    made.environment = sv.Sky((-1.0, 0.62, 0.22))
    made.camera = sv.Camera.look_at((2.5, 1.6, 1.3), (-1.5, 2.7, -7), fov=52, ev100=10.5)
    return made
