"""How far two pictures are apart: `compare`."""

from __future__ import annotations

import importlib.util
import math
import os
from numbers import Real
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, checked_keywords, quoted, warn
from solari_vk.base.files import followed
from solari_vk.output.picture import EIGHT_BIT, check_output, write_codes
from solari_vk.output.tone_mapping import auto_exposure, unseen
from solari_vk.scene.camera import Camera, exposure_of
from solari_vk.scene.images.mip_chain import LINEAR_OF_SRGB
from solari_vk.scene.images.radiance_files import read_colors

INSTALL_FLIP = "pip install flip-evaluator"


class Difference(NamedTuple):
    """What two pictures differ by."""

    relative_mse: float
    """relMSE: the mean of the squared error over the squared reference, to which 1 % of its squared mean is added."""
    mean_ratio: NDArray[np.float64]
    """The mean of the picture over that of the reference, (3,): below 1 it is darker."""
    flip: float
    """The mean FLIP, from 0 to 1, at five exposures a stop apart, of pictures of 8 bits as they are; NaN without the
    package flip-evaluator. Andersson et al., "Visualizing Errors in Rendered High Dynamic Range Images" (2021)."""


@checked_keywords(who="solari_vk")
def compare(
    picture: Any, reference: Any, *, exposure: float | None = None, heatmap: str | os.PathLike[str] | None = None
) -> Difference:
    """How far a picture is from a reference.

    picture, reference: arrays (height, width, 3) of radiance, frames of a renderer, or paths of .exr and .hdr files; or
    two pictures of 8 bits, which are sRGB: uint8 arrays such as `frame.image()`, or paths of .png and .jpg files. The
    reference's noise is part of the error. exposure: the factor around which FLIP looks at radiance, such as
    `camera.exposure`. By default it is that of the reference's camera, else of the picture's, as far as something can
    be seen with it; for arrays `auto_exposure` of the reference. Pictures of 8 bits are looked at as they are. heatmap:
    a .png or .jpg to write, in which FLIP's errors go from black over red to yellow. Warns where FLIP isn't installed.
    Raises SolariError for pictures of other or different shapes and kinds, for values that aren't finite, and for a
    heatmap without FLIP.
    """
    if exposure is not None and not (isinstance(exposure, Real) and 0 < exposure < math.inf):
        raise SolariError(f"compare: exposure is a factor above 0, such as camera.exposure, not {quoted(exposure)}")
    if heatmap is not None:
        check_output(heatmap, EIGHT_BIT)
        if not has_flip():
            raise SolariError(f"{heatmap}: a heatmap is made by FLIP: {INSTALL_FLIP}")
    colors, in_8_bits = _read(picture)
    true, true_in_8_bits = _read(reference)
    if in_8_bits != true_in_8_bits:
        raise SolariError("compare: takes two pictures of 8 bits, or two of radiance: one is of 8 bits here")
    if colors.shape != true.shape:
        raise SolariError(f"compare: pictures have one size, not {colors.shape} and {true.shape}")
    # The mean of a channel may be 0 in both: then the ratio is nan, as it should be.
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = colors.mean(axis=(0, 1)) / true.mean(axis=(0, 1))
    if in_8_bits:
        exposure = None
    elif exposure is None:
        exposure = _shown_with(true, reference, picture)
    if not has_flip():
        warn(f"compare: FLIP is left out, as nan: {INSTALL_FLIP}")
    if heatmap is not None:
        _write_heatmap(Path(heatmap), colors, true, exposure)
    return Difference(relative_mse(colors, true), ratio, flip(colors, true, exposure))


def _write_heatmap(path: Path, image: NDArray[Any], reference: NDArray[Any], exposure: float | None) -> None:
    errors = _evaluate(image, reference, exposure, applyMagma=True)[0]
    write_codes(followed(path), np.rint(255 * np.clip(errors, 0, 1)).astype(np.uint8))


def _shown_with(radiance: NDArray[np.float64], *pictures: Any) -> float:
    """The exposure that frames are shown with, by the camera of the first one that has one."""
    for camera in (getattr(picture, "camera", None) for picture in pictures):
        if isinstance(camera, Camera) and unseen(radiance * camera.exposure) in ("", "black"):
            return camera.exposure
    return exposure_of(auto_exposure(radiance))


def _read(picture: Any) -> tuple[NDArray[np.float64], bool]:
    """The linear colors of a picture, and whether it is one of 8 bits."""
    if isinstance(picture, str | os.PathLike):
        found = np.asarray(read_colors(picture, what="a picture to compare"), np.float64)
        in_8_bits = Path(picture).suffix.lower() not in (".exr", ".hdr")
    else:
        is_frame = not isinstance(picture, np.ndarray) and hasattr(picture, "keys")
        values = picture["radiance"] if is_frame else picture
        in_8_bits = getattr(values, "dtype", None) == np.uint8
        try:
            found = np.asarray(LINEAR_OF_SRGB[values] if in_8_bits else values, np.float64)
        except (TypeError, ValueError):
            found = np.empty(0)  # which is refused below, with what was given
    if found.ndim != 3 or found.shape[2] != 3 or not found.size or not np.isfinite(found).all():
        shown = picture.shape if isinstance(picture, np.ndarray) else picture
        raise SolariError(
            "compare: takes frames, arrays (height, width, 3) of finite radiance or of 8 bits, or paths, "
            f"not {quoted(shown)}"
        )
    return found, in_8_bits


def squared_scale(reference: NDArray[Any]) -> NDArray[Any]:
    """What relMSE divides squared errors by: the squared reference, plus 1 % of its squared mean."""
    # Without the floor a few black pixels would be the whole error; 1e-12 is for pictures that are black.
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


def has_flip() -> bool:
    """Whether FLIP's package is installed."""
    return importlib.util.find_spec("flip_evaluator") is not None


def flip(image: NDArray[Any] | None, reference: NDArray[Any], exposure: float | None) -> float:
    """The mean FLIP at five exposures around the camera's, a stop apart; NaN without its package or an image.

    exposure: None for pictures of 8 bits, by their linear colors, which are looked at as they are.
    """
    return math.nan if image is None or not has_flip() else float(_evaluate(image, reference, exposure)[1])


def _evaluate(
    image: NDArray[Any], reference: NDArray[Any], exposure: float | None, applyMagma: bool = False
) -> tuple[Any, ...]:
    """FLIP's map of errors, and their mean."""
    import flip_evaluator

    pair = [np.ascontiguousarray(np.maximum(picture, 0.0), np.float32) for picture in (reference, image)]
    if exposure is None:
        found = flip_evaluator.evaluate(*pair, "LDR", inputsRGB=False, applyMagma=applyMagma)
    else:
        # FLIP counts exposures in stops; the camera's is a factor.
        middle = math.log2(exposure)
        exposures = {"startExposure": middle - 2, "stopExposure": middle + 2, "numExposures": 5}
        found = flip_evaluator.evaluate(*pair, "HDR", applyMagma=applyMagma, parameters=exposures)
    return tuple(found)
