"""The Python side of picture.js: movements that a page sends, and pictures for it."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.base.errors import SolariError
from solari_vk.studio.viewer.camera_control import CameraControl

PICTURE_JS = Path(__file__).with_name("picture.js")


def number(value: Any) -> float:
    """A number that a page sent. Raises ValueError or TypeError for others, NaN and infinities among them: bounds
    don't refuse NaN, with which all comparisons are false."""
    found = float(value)
    if not math.isfinite(found):
        raise ValueError(f"{found} is no number of JSON")
    return found


def move(control: CameraControl, movement: Mapping[str, Any], center: ArrayLike | None = None) -> bool:
    """Move the camera as a page asks; returns whether there was anything to do.

    movement: what `take` of picture.js returns. center: the point to orbit around, by default what is seen in the
    middle. Raises ValueError, TypeError or SolariError for what are no numbers.
    """
    # What a page sends isn't trusted: `number` refuses what is none, and the control limits the others.
    names = ("right", "down", "pan_right", "pan_down", "notches")
    right, down, pan_right, pan_down, notches = (number(movement.get(name, 0)) for name in names)
    home = bool(movement.get("home"))
    if home:
        control.reset()
    if right or down:
        control.orbit(right, down, control.center if center is None else center)
    if pan_right or pan_down:
        control.pan(pan_right, pan_down)
    if notches:
        control.zoom(notches)
    return any((home, right, down, pan_right, pan_down, notches))


def encoded(codes: NDArray[np.uint8], kind: str, quality: int = 85, size: tuple[int, int] | None = None) -> bytes:
    """A picture (height, width, 3), sRGB, as the bytes of a "png" or a "jpeg". size: the width and height to shrink it
    to; it is never enlarged."""
    from PIL import Image

    picture = Image.fromarray(np.ascontiguousarray(codes))
    if size is not None and size[0] < picture.width:
        picture = picture.resize(size, Image.Resampling.BILINEAR)
    content = io.BytesIO()
    # zlib's first level: higher ones take several times as long for a few percent of a rendered picture.
    options = {"quality": quality} if kind == "jpeg" else {"compress_level": 1}
    picture.save(content, format=kind, **options)
    return content.getvalue()


def error_text(error: BaseException) -> str:
    """What a page says of an error: the text of one of the package's own, otherwise its type too."""
    return str(error) if isinstance(error, SolariError) else f"{type(error).__name__}: {error}"
