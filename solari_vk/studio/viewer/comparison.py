"""How far pictures are from the path tracer's, pixel by pixel of what is rendered."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.output.error import area_means, luminance, relative_squares
from solari_vk.passes.debug_views import PICTURE
from solari_vk.renderers.path_tracer import PathTracer
from solari_vk.studio.viewer.pictures import Pictures


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


def errors(pictures: Pictures) -> dict[str, tuple[float, float]]:
    """How far the pictures in `columns` are from the path tracer's, by name, as `difference` says it.

    Empty unless the mode is "split" and the view is "picture", the only one that the path tracer has too.
    """
    if pictures.mode != "split" or pictures.view != PICTURE or not pictures.ready:
        return {}
    assert pictures.realtime is not None
    assert pictures.reference is not None
    results = {"raw": "raw_radiance", "denoised": "radiance", "realtime": "radiance"}
    names = [name for name in pictures.columns() if name in results]
    found = {name: difference(pictures.realtime[results[name]], pictures.reference.tracer) for name in names}
    return {name: error for name, error in found.items() if error is not None}
