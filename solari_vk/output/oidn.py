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
    radiance: NDArray[Any], albedo: NDArray[Any] | None, normal: NDArray[Any] | None, *, clean: bool = True
) -> NDArray[np.float32]:
    """Radiance (height, width, 3) without noise, on the processor.

    albedo and normal: those of the visible surfaces, (height, width, 3) each, or None; OIDN takes normals only beside
    albedo. clean: whether they are averages over each pixel's area, free of noise. Raises SolariError without the
    package, and for an error of OIDN.
    """
    library = _library()
    # Filters of renderers leave negative values.
    mean = float(np.mean(np.maximum(radiance, 0), dtype=np.float64))
    # OIDN makes a faint light of a picture without any.
    if mean == 0:
        return np.zeros(radiance.shape, np.float32)
    # A power of two scales radiance without rounding to where OIDN works well, whatever its unit.
    shift = -round(math.log2(mean)) if mean < math.inf else 0
    color = np.ldexp(np.asarray(radiance, np.float32), shift)
    guides = {}
    if albedo is not None:
        guides["albedo"] = np.clip(albedo, 0, 1, dtype=np.float32)
        if normal is not None:
            guides["normal"] = np.asarray(normal, np.float32)
    try:
        result: NDArray[np.float32] = library.denoise(color, **guides, hdr=True, clean_aux=clean and bool(guides))
    except (RuntimeError, OSError) as error:
        raise SolariError(f"denoise: {error}") from None
    return np.ldexp(result, -shift)


def prefilter(kind: str, picture: NDArray[Any]) -> NDArray[np.float32]:
    """A picture of the "albedo" or the "normal" of visible surfaces (height, width, 3) without noise, by the network
    that OIDN has for it. Raises SolariError without the package, and for an error of OIDN."""
    library = _library()
    source = np.ascontiguousarray(np.clip(picture, 0, 1) if kind == "albedo" else picture, np.float32)
    result = np.zeros_like(source)
    device = library.Device()
    device.commit()
    work = library.Filter(device, library.OIDN_FILTER_TYPE_RT)
    try:
        for name, image in ((kind, source), ("output", result)):
            work.set_image(name, image, library.OIDN_FORMAT_FLOAT3)
        work.commit()
        work.execute()
    except (RuntimeError, OSError, ValueError) as error:
        raise SolariError(f"denoise: {error}") from None
    finally:
        work.release()
        device.release()
    return result
