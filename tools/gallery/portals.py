"""A portal in a window: the same room after the same number of samples, without and with one.

Only a small part of the sky is seen through the window. A `Portal` in it tells the path tracer where to send its rays.
Neither picture is denoised.
"""

from __future__ import annotations

from pathlib import Path

import solari_vk as sv
from solari_vk.lab.measure.portals import window_room

SAMPLES = 64


def panels(assets: Path) -> dict[str, sv.Scene]:
    """The room that `solari-vk bench portals` measures."""
    skies = {False: f"without a portal, {SAMPLES} samples", True: f"with a portal, {SAMPLES} samples"}
    return {label: window_room(sv.Sky(), with_portal=is_there) for is_there, label in skies.items()}
