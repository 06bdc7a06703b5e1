"""A clear sky: sunlight scattered by air and haze, and the sun itself, which is low here."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import solari_vk as sv


def scene(assets: Path | None) -> sv.Scene:
    """Columns on a plain, with the sun at the left."""
    made = sv.Scene(sv.Camera.look_at((0, 1.5, 9), (0, 1.6, 0), vertical_fov=0.7, ev100=12.0))
    stone, plain = sv.Material(base_color=(0.7, 0.65, 0.6), roughness=0.9), sv.Material(base_color=(0.3, 0.3, 0.3))
    made.add(sv.shapes.quad((0, 0, 0), (0, 0, 200), (200, 0, 0)), plain)
    for number in range(7):
        column = np.eye(4)
        column[:3, :3] = np.diag((0.4, 3.2, 0.4))
        column[:3, 3] = (1.3 * number - 3.9, 1.6, -0.8 * number)
        made.add(sv.shapes.box(), stone, column)
    made.environment = sv.Sky((-1.0, 0.16, -1.0), turbidity=2.0)
    return made
