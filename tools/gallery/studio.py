"""A studio for files without lights: soft boxes before a gray wall, and a floor that shows nothing but shadows."""

from __future__ import annotations

from pathlib import Path

import solari_vk as sv


def scene(assets: Path | None) -> sv.Scene:
    """A helmet, or two balls where there is no file of it."""
    file = assets / "FlightHelmet" / "FlightHelmet.gltf" if assets else None
    if file is not None and file.is_file():
        made = sv.load_gltf(file)
    else:
        made = sv.Scene()
        for x, metallic in ((-0.6, 1.0), (0.6, 0.0)):
            paint = sv.Material(base_color=(0.8, 0.3, 0.2), metallic=metallic, roughness=0.3)
            made.add(sv.shapes.sphere(0.5, 48), paint, (x, 0.5, 0))
    return sv.studio_lights(made, camera=made.camera_for(16 / 9))
