"""A panorama: 360 x 180 degrees.

`sv.Camera(projection="equirectangular")`, in the room of the fisheye lens. The middle is the view axis.
"""

from __future__ import annotations

import runpy
from pathlib import Path

import solari_vk as sv

ASPECT = 2


def scene(assets: Path | None) -> sv.Scene:
    """The room, seen from the same place."""
    made: sv.Scene = runpy.run_path(str(Path(__file__).with_name("fisheye.py")))["scene"](assets)
    camera = sv.Camera(transform=made.camera.transform, ev100=made.camera.ev100, projection="equirectangular")
    made.camera = camera
    return made
