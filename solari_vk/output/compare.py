"""How far two pictures are apart: `compare`."""

from __future__ import annotations

import importlib.util
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.errors import SolariError, quoted
from solari_vk.output.tone_mapping import auto_exposure, unseen
from solari_vk.scene.camera import Camera
from solari_vk.scene.exposed import exposure_of


class Difference(NamedTuple):
    """What two pictures differ by."""

    relative_mse: float
    """relMSE: the mean of the squared error over the squared reference, to which 1 % of its squared mean is added."""
    mean_ratio: NDArray[np.float64]
    """The mean of the picture over that of the reference, (3,): below 1 it is darker."""
    flip: float
    """The mean FLIP, from 0 to 1, at five exposures a stop apart; NaN without the package flip-evaluator. Andersson et
    al., "Visualizing Errors in Rendered High Dynamic Range Images" (2021)."""


def compare(picture: Any, reference: Any, *, exposure: float | None = None) -> Difference:
    """How far a picture is from a reference.

    picture, reference: arrays (height, width, 3) of radiance, or frames of a renderer. The reference's noise is part of
    the error. exposure: the factor around which FLIP looks, such as `camera.exposure`. By default it is that of the
    reference's camera, else of the picture's, as far as something can be seen with it; for arrays `auto_exposure` of
    the reference. Raises SolariError for arrays of other or different shapes, and for values that aren't finite.
    """
    if exposure is not None and not (isinstance(exposure, (int, float)) and 0 < exposure < math.inf):
        raise SolariError(f"compare: exposure is a factor above 0, such as camera.exposure, not {quoted(exposure)}")
    given, true = _radiance(picture), _radiance(reference)
    if given.shape != true.shape:
        raise SolariError(f"compare: pictures have one size, not {given.shape} and {true.shape}")
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = given.mean(axis=(0, 1)) / true.mean(axis=(0, 1))
    factor = _shown_with(true, reference, picture) if exposure is None else exposure
    return Difference(relative_mse(given, true), ratio, flip(given, true, factor))


def _shown_with(radiance: NDArray[np.float64], *pictures: Any) -> float:
    """The exposure that frames are shown with, by the camera of the first one that has one."""
    for camera in (getattr(picture, "camera", None) for picture in pictures):
        if isinstance(camera, Camera) and unseen(radiance * camera.exposure) in ("", "black"):
            return camera.exposure
    return exposure_of(auto_exposure(radiance))


def _radiance(picture: Any) -> NDArray[np.float64]:
    given = picture if isinstance(picture, np.ndarray) or not hasattr(picture, "keys") else picture["radiance"]
    try:
        found = np.asarray(given, np.float64)
    except (TypeError, ValueError):
        found = np.empty(0)
    eight_bit = getattr(given, "dtype", None) == np.uint8
    if found.ndim != 3 or found.shape[2] != 3 or not found.size or eight_bit or not np.isfinite(found).all():
        raise SolariError("compare: takes frames, or arrays (height, width, 3) of finite radiance (not of 8 bits), not "
                          f"{quoted(picture if not isinstance(picture, np.ndarray) else picture.shape)}")  # fmt: skip
    return found


def squared_scale(reference: NDArray[Any]) -> NDArray[Any]:
    """What relMSE divides squared errors by: the squared reference, plus 1 % of its squared mean."""
    scale: NDArray[Any] = reference**2 + (1e-2 * float(np.mean(reference)) ** 2 + 1e-12)
    return scale


def relative_mse(image: NDArray[Any], reference: NDArray[Any]) -> float:
    """The mean of the squared error over the squared reference, to which 1 % of its squared mean is added."""
    return float(((image - reference) ** 2 / squared_scale(reference)).mean())


def true_relative_mse(image: NDArray[Any], first: NDArray[Any], second: NDArray[Any]) -> float:
    """relative_mse against the truth, of which two references with independent noise are given.

    The noise of a single reference adds its variance to the error. In the product of both differences it cancels out
    on average.
    """
    return float(((image - first) * (image - second) / squared_scale((first + second) / 2)).mean())


def flip(image: NDArray[Any] | None, reference: NDArray[Any], exposure: float) -> float:
    """The mean FLIP at five exposures around the camera's, a stop apart; NaN without its package or an image."""
    if image is None or importlib.util.find_spec("flip_evaluator") is None:
        return math.nan
    import flip_evaluator

    given = (np.ascontiguousarray(np.maximum(picture, 0.0), np.float32) for picture in (reference, image))
    middle = math.log2(exposure)
    exposures = {"startExposure": middle - 2, "stopExposure": middle + 2, "numExposures": 5}
    return float(flip_evaluator.evaluate(*given, "HDR", applyMagma=False, parameters=exposures)[1])
