"""A thousand lamps in forty rooms.

Walls hide nearly all lamps from each surface; a little light comes through doors that are ajar.
"""

from __future__ import annotations

from pathlib import Path

import solari_vk as sv


def scene(assets: Path) -> sv.Scene:
    """The built-in scene `rooms`."""
    return sv.builtin("rooms")
