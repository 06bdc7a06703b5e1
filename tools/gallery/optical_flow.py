"""Optical flow as colors: where each pixel's point goes in the next picture.

`sv.optical_flow`: a color is a direction, and its strength the distance. What is hidden in the next picture is dark.
The wheel turns, the ball passes, and the camera moves to the right.
"""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import solari_vk as sv

STEP = 0.15
_MOVING: dict[str, Any] = runpy.run_path(str(Path(__file__).with_name("motion_blur.py")))


def scene(assets: Path | None) -> sv.Scene:
    """The scene of motion blur at a first time."""
    made: sv.Scene = _MOVING["scene"](assets)
    return made


def draw(device: sv.Device, made: sv.Scene, picture: Image.Image) -> Image.Image:
    """The flow to the picture STEP later, by hue and saturation as in Baker et al., "A Database and Evaluation
    Methodology for Optical Flow" (2011)."""
    later = sv.Camera.look_at((0.36, 1.4, 4.2), (0.36, 0.95, 0), vertical_fov=made.camera.vertical_fov)
    times = 0.5, 0.5 + STEP
    with sv.RayTracer(device, made) as tracer:
        found, _ = sv.optical_flow(
            tracer, (made.camera, later), picture.size, times=times, pose=lambda seconds: _MOVING["pose"](made, seconds)
        )
    flow = np.nan_to_num(found.flow)
    length = np.linalg.norm(flow, axis=-1)
    hue = np.arctan2(flow[..., 1], flow[..., 0]) / (2 * np.pi) % 1
    value = np.where(found.state == 0, 1.0, 0.35)
    colors = np.stack([hue, np.minimum(length / np.quantile(length, 0.98), 1), value], -1)
    return Image.fromarray((255 * colors).astype(np.uint8), "HSV").convert("RGB")
