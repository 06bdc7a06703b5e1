"""How far pictures are from the path tracer's, pixel by pixel of what is rendered."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.output.error import area_means, luminance, relative_squares
from solari_vk.reference import PathTracer


def difference(picture: NDArray[Any], tracer: PathTracer) -> tuple[float, float] | None:
    """(error, relative difference of mean radiance) of a picture (height, width, 3) against the path tracer's.

    The error is the root of relMSE as output/error.py defines it; the path tracer's own noise counts until it has
    refined. A picture of another size is averaged to the path tracer's. None before the path tracer has two samples,
    and in the dark.
    """
    reference = tracer["raw_radiance"]
    mean = float(reference.mean(dtype=np.float64))
    if tracer.samples < 2 or not mean > 0:
        return None
    resized = area_means(picture, tracer.size)
    squares = (luminance(resized) - luminance(reference)) ** 2
    error = math.sqrt(float(relative_squares(reference, squares).mean()))
    return error, float(resized.mean()) / mean - 1
