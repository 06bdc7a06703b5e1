"""Light through stained glass: glTF's KHR_materials_transmission.

The sun shines through thin panes. What passes takes their colors, in shadows and in the mirror too.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import solari_vk as sv
from solari_vk.scene import shapes

COLORS = ((0.9, 0.08, 0.05), (0.95, 0.6, 0.05), (0.1, 0.6, 0.15), (0.05, 0.25, 0.9), (0.6, 0.1, 0.7))


def scene(assets: Path | None) -> sv.Scene:
    """Five panes between the sun and a floor with a ball, beside a mirror."""
    made = sv.Scene(sv.DirectionalLight((-0.1, -1.0, 1.1), illuminance=60_000), name="stained glass")
    made.add(shapes.quad((0, 0, 0), (6, 0, 0), (0, 0, -6)), sv.Material(base_color=0.7, roughness=0.9))
    made.environment = sv.Environment(np.full((2, 4, 3), 900.0, np.float32))
    mirror = sv.Material(base_color=0.9, metallic=1.0, roughness=0.0)
    made.add(shapes.quad((2.6, 1, -0.4), (0.0, 0, 1.2), (0, 1, 0)), sv.Material(double_sided=True, roughness=0.6))
    made.add(shapes.quad((2.55, 1, -0.4), (0.0, 0, 1.2), (0, 1, 0)), mirror)
    for index, color in enumerate(COLORS):
        pane = shapes.quad((index - 2.0, 1.0, -0.9), (0.45, 0, 0), (0, 0.95, 0))
        glass = sv.Material(base_color=color, transmission=1.0, roughness=0.0, double_sided=True)
        made.add(pane, glass)
    made.add(shapes.sphere(0.4), sv.Material(base_color=0.85, roughness=0.8), (0, 0.4, 0.5))
    made.camera = sv.Camera.look_at((-1.2, 2.2, 4.6), (0.2, 0.6, -0.1), ev100=13.0)
    return made
