"""Unlit materials: glTF's KHR_materials_unlit.

Both charts have the same colors. The right one is unlit: the warm lamp beside them doesn't change it, and it lights
nothing, but casts a shadow. So screens, signs and sketches keep their colors.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import solari_vk as sv

ROWS = (
    ("#735244", "#c29682", "#627a9d", "#576c43", "#8580b1", "#67bdaa"),
    ("#d67e2c", "#505ba6", "#c15a63", "#5e3c6c", "#9dbc40", "#e0a32e"),
    ("#383d96", "#469449", "#af363c", "#e7c71f", "#bb5695", "#0885a1"),
    ("#f3f3f2", "#c8c8c8", "#a0a0a0", "#7a7a79", "#555555", "#343434"),
)


def chart() -> sv.Texture:
    """The 24 patches of a ColorChecker, with gaps."""
    pixels = np.full((4 * 16, 6 * 16, 3), 25, np.uint8)
    for row, codes in enumerate(ROWS):
        for column, code in enumerate(codes):
            patch = pixels[16 * row + 1 : 16 * row + 15, 16 * column + 1 : 16 * column + 15]
            patch[...] = tuple(bytes.fromhex(code[1:]))
    return sv.Texture(image=pixels[::-1], magnification="nearest", minification="nearest", mipmaps=False)


def scene(assets: Path) -> sv.Scene:
    """A lit chart and an unlit one on a table."""
    made = sv.Scene(name="unlit")
    made.add(sv.shapes.plane(12), sv.Material(base_color=(0.25, 0.14, 0.08), roughness=0.25), name="table")
    made.add(sv.shapes.quad((0, 3, -2), (8, 0, 0), (0, 3, 0)), sv.Material(base_color=(0.3, 0.33, 0.36)), name="wall")
    for x, unlit in ((-1.1, False), (1.1, True)):
        card = sv.Material(base_color_texture=chart(), unlit=unlit, double_sided=True, roughness=0.8)
        made.add(sv.shapes.quad((x, 0.72, 0), (0.96, 0, 0), (0, 0.66, -0.25)), card)
    lamp = sv.Material(base_color=0, emissive=60 * sv.kelvin(2000))
    made.add(sv.shapes.sphere(0.22, 48), lamp, (-2.75, 1.3, 0.5), name="lamp")
    made.environment = sv.Environment(0.05)
    made.camera = sv.Camera.look_at((0.1, 1.5, 5.2), (-0.1, 0.8, 0), fov=33, ev100=0.0)
    return made
