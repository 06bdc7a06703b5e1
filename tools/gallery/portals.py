"""Portals: a room by the light of a window.

A portal in the window sends light samples through it. The sky is a photograph where one is given.
"""

from __future__ import annotations

from pathlib import Path

import solari_vk as sv
from solari_vk.measure.portals import window_room


def scene(assets: Path | None) -> sv.Scene:
    """The room of `solari-vk bench portals`."""
    maps = sorted((assets / "hdri").glob("*.hdr")) if assets else []
    sky = sv.Environment(maps[0], rotation=2.0) if maps else sv.Environment(sv.Sky().image, intensity=1e-4)
    made = window_room(sky, with_portal=True)
    made.camera.ev100 = -2.5
    return made
