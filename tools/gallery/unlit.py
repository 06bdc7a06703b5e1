"""Unlit materials: glTF's KHR_materials_unlit.

Both cards have the same colors. The right one is unlit: the lamp beside it doesn't change it, and it lights nothing,
but casts a shadow.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import solari_vk as sv
from solari_vk.scene import shapes


def scene(assets: Path | None) -> sv.Scene:
    """A lit card and an unlit one on a floor."""
    made = sv.Scene(name="unlit")
    made.add(shapes.quad((0, 0, 0), (6, 0, 0), (0, 0, -6)), sv.Material(base_color=0.6, roughness=0.9))
    rows, columns = np.indices((6, 6))
    pixels = np.stack([40 + 40 * rows, 200 - 30 * columns, 60 + 190 * ((rows + columns) % 2)], axis=-1)
    image = sv.TextureImage(pixels=pixels.astype(np.uint8))
    texture = sv.Texture(image=image, magnification="nearest", minification="nearest", mipmaps=False)
    for x, unlit in ((-0.9, False), (0.9, True)):
        card = sv.Material(base_color=1.0, base_color_texture=texture, unlit=unlit, double_sided=True, roughness=0.8)
        made.add(shapes.quad((x, 0.75, 0), (0.7, 0, 0), (0, 0.7, 0)), card)
    lamp = sv.Material(base_color=0.0, emissive=25.0)
    made.add(shapes.quad((-2.2, 2.6, 1.2), (0.4, -0.3, 0), (0, 0, 0.5)), lamp)
    made.environment = sv.Environment(np.full((2, 4, 3), 0.15, np.float32))
    made.camera = sv.Camera.look_at((0, 1.6, 4.4), (0, 0.65, 0), ev100=0.0)
    return made
