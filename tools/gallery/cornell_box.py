"""The Cornell box: an emissive mesh as the only light."""

from __future__ import annotations

from pathlib import Path

import solari_vk as sv


def scene(assets: Path | None) -> sv.Scene:
    """The built-in scene."""
    return sv.builtin("cornell_box")
