"""KTX2 textures: AnisotropyBarnLamp, a sample of Khronos.

Its maps of normals and of roughness are KTX2 files. The file has no camera, so the model is framed from above at an
angle.
"""

from __future__ import annotations

from pathlib import Path

import solari_vk as sv


def scene(assets: Path | None) -> sv.Scene:
    """The lamp; without the assets a ball, so that the page can be made everywhere."""
    if assets is None:
        made = sv.Scene()
        made.add(sv.shapes.sphere(0.5, 48), sv.Material(base_color=0.7, metallic=1, roughness=0.3), name="ball")
    else:
        made = sv.load(assets / "AnisotropyBarnLamp" / "AnisotropyBarnLamp.gltf")
    camera = made.camera_for(16 / 9)
    sv.studio_lights(made, camera=camera)
    made.camera = camera
    return made
