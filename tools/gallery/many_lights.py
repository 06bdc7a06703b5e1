"""A plain with 441 lamps and 8,000 boxes.

Each surface chooses lamps by a tree, and the denoiser has little light to go by: most is a few samples a pixel.
"""

from __future__ import annotations

from pathlib import Path

import solari_vk as sv


def scene(assets: Path) -> sv.Scene:
    """The built-in scene `many_lights`."""
    return sv.builtin("many_lights")
