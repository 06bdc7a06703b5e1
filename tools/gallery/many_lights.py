"""A plain with 441 lamps and 8,000 boxes.

Each surface chooses among lamps by a tree of lights, which finds those that matter there.
"""

from __future__ import annotations

from pathlib import Path

import solari_vk as sv


def scene(assets: Path) -> sv.Scene:
    """The built-in scene `many_lights`."""
    return sv.builtin("many_lights")
