"""Intel Open Image Denoise (OIDN), by the optional package `pyoidn`: a neural network that denoises still pictures."""

from __future__ import annotations

import importlib.util
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError

_INSTALL = "install it by \"pip install 'solari-vk[oidn]'\", or render without it"


def is_installed() -> bool:
    """Whether the package that brings OIDN is installed. It may not load: see `check_installed`."""
    return importlib.util.find_spec("pyoidn") is not None


def check_installed() -> None:
    """Raise SolariError without the package, or if the libraries in it don't load."""
    _library()


def _library() -> Any:
    if not is_installed():
        raise SolariError(f"denoise needs Intel Open Image Denoise, the package pyoidn: {_INSTALL}")
    try:
        import pyoidn

        pyoidn.Device.is_cpu_available()  # loads the libraries, which the import doesn't
    except (ImportError, OSError, AttributeError) as error:
        raise SolariError(f"denoise: the package pyoidn doesn't load ({error}): {_INSTALL}") from None
    return pyoidn


def denoise(
    radiance: NDArray[Any], albedo: NDArray[Any], normal: NDArray[Any], *, clean: bool = True
) -> NDArray[np.float32]:
    """Radiance (height, width, 3) without noise, on the processor.

    albedo and normal: those of the visible surfaces, (height, width, 3) each. clean: whether they are averages over
    each pixel's area, free of noise. Raises SolariError without the package, and for an error of OIDN.
    """
    library = _library()
    mean = float(np.mean(radiance, dtype=np.float64))
    # OIDN makes a faint light of a picture without any.
    if mean == 0:
        return np.zeros(radiance.shape, np.float32)
    # A power of two scales radiance without rounding to where OIDN works well, whatever its unit.
    shift = -round(math.log2(mean)) if mean < math.inf else 0
    color = np.ldexp(np.asarray(radiance, np.float32), shift)
    guides = np.clip(albedo, 0, 1, dtype=np.float32), np.asarray(normal, np.float32)
    try:
        result: NDArray[np.float32] = library.denoise(color, *guides, hdr=True, clean_aux=clean)
    except (RuntimeError, OSError) as error:
        raise SolariError(f"denoise: {error}") from None
    return np.ldexp(result, -shift)
