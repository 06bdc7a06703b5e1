"""Converters for the fields of the scene's objects: they check a value, and return a read-only copy.

A converter raises TypeError or ValueError with a text that continues the field's name ("transform must be ...").
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.base.errors import SolariError, quoted, shortened
from solari_vk.base.host_array import host_array
from solari_vk.scene.images.mip_chain import LINEAR_OF_SRGB
from solari_vk.scene.matrices import thickened, unit
from solari_vk.scene.observable import Checked

FloatArray = NDArray[np.float32]
WRAP_MODES = ("repeat", "mirrored_repeat", "clamp_to_edge")
FILTERS = ("linear", "nearest")
ALPHA_MODES = ("opaque", "mask", "blend")
LARGEST_CUTOFF = 1e6
LARGEST_COORDINATE = 1e18  # meters: the areas of larger triangles overflow
LARGEST_RADIANCE = 1e18  # cd/m^2: products along a path must not overflow
LARGEST_TRANSFORM = 1e12  # the product of three axes must not overflow


def real(value: Any, dtype: Any = None) -> NDArray[Any]:
    """An array of real numbers; numpy would drop imaginary parts, and take objects for numbers."""
    values = host_array(value)
    # Booleans, integers and floats.
    if values.size and values.dtype.kind not in "biuf":
        raise ValueError(f"must be real numbers, not {values.dtype}")
    return values if dtype is None else values.astype(dtype)


def array(
    *shape: int | None, dtype: Any = np.float32, optional: bool = False, max_abs: float = math.inf
) -> Callable[[Any], Any]:
    """A finite, read-only array of a shape, where None stands for any length. max_abs: the largest absolute value."""

    def convert(value: Any) -> Any:
        if value is None and optional:
            return None
        values = real(value)
        if np.issubdtype(dtype, np.integer):
            _refuse_unless_integers(values, dtype)
        with np.errstate(over="ignore"):  # overflow gives infinity, which is refused below
            array = np.array(values, dtype=dtype, order="C")
        _refuse_other_shapes(array, shape)
        refuse_not_finite(array)
        if max_abs < math.inf and array.size and np.abs(array).max() > max_abs:
            raise ValueError(f"must lie within {max_abs:g}")
        array.setflags(write=False)
        return array

    return convert


def _refuse_unless_integers(values: NDArray[Any], dtype: Any) -> None:
    """Raise ValueError for numbers that this type of integers doesn't have: numpy would wrap them around."""
    if not values.size:
        return
    if not np.issubdtype(values.dtype, np.integer):
        raise ValueError(f"must be integers, not {values.dtype}")
    largest = np.iinfo(dtype).max
    if values.min() < 0 or values.max() > largest:
        raise ValueError(f"must lie between 0 and {largest}")


def _refuse_other_shapes(array: NDArray[Any], shape: tuple[int | None, ...]) -> None:
    """Raise ValueError unless an array has a shape, in which None stands for any length."""
    has_shape = array.ndim == len(shape)
    if has_shape and all(wanted in (None, length) for wanted, length in zip(shape, array.shape, strict=True)):
        return
    lengths = ["N" if length is None else str(length) for length in shape]
    wanted = f"{lengths[0]}," if len(lengths) == 1 else ", ".join(lengths)
    raise ValueError(f"must have the shape ({wanted}), not {array.shape}")


def vertex_colors(value: Any) -> FloatArray | None:
    """Read-only colors (N, 3) or (N, 4) in [0, 1]."""
    if value is None:
        return None
    columns = 4 if np.shape(value)[1:] == (4,) else 3
    colors: FloatArray = array(None, columns)(value)
    if colors.size and not (colors.min() >= 0 and colors.max() <= 1):
        raise ValueError("must lie between 0 and 1")
    return colors


def flag(value: Any) -> bool:
    """True or False, also as numpy's, or as 1 or 0."""
    if not isinstance(value, (int, np.bool_, np.integer)) or value not in (0, 1):
        raise ValueError(f"must be True or False, not {quoted(value)}")
    return bool(value)


def flag_or_none(value: Any) -> bool | None:
    """A flag that None leaves unsaid."""
    return None if value is None else flag(value)


def whole(low: int, high: int) -> Callable[[Any], int]:
    """A whole number in a range."""

    def convert(value: Any) -> int:
        if not isinstance(value, (int, np.integer)) or not low <= value <= high:
            raise ValueError(f"must be a whole number from {low} to {high}, not {quoted(value)}")
        return int(value)

    return convert


def pixels(value: Any) -> NDArray[np.uint8]:
    """A read-only RGBA image (height, width, 4) with 8 bits per channel, from an RGBA, an RGB or a gray image, of 8 or
    16 bits or of floats in [0, 1], or from the path of a file."""
    if isinstance(value, (str, os.PathLike)):
        from solari_vk.scene.images.image_files import read_pixels

        value = read_pixels(value)
    values = host_array(value)
    if values.dtype.kind == "f":
        with np.errstate(over="ignore"):
            # NaN fails both comparisons.
            parts = values.astype(np.float32)
        if not ((parts >= 0) & (parts <= 1)).all():
            raise ValueError("must lie between 0 and 1, or be integers of 8 or 16 bits")
        values = np.rint(parts * np.float32(255)).astype(np.uint8)
    elif values.dtype == np.uint16:
        values = np.rint(values / 257).astype(np.uint8)
    if values.ndim == 2:
        values = values[..., None]
    if values.ndim == 3 and values.shape[2] == 1:
        values = np.repeat(values, 3, axis=2)
    if values.ndim == 3 and values.shape[2] == 3:
        values = np.concatenate([values, np.full_like(values[..., :1], 255)], axis=-1)
    try:
        found: NDArray[np.uint8] = array(None, None, 4, dtype=np.uint8)(values)
    except ValueError as error:
        raise ValueError(f"{error}: give 8-bit pixels, uint16, or floats, (height, width[, 1, 3 or 4])") from None
    return found


def check_whole(what: str, value: Any, low: int = 0, high: int | None = None) -> None:
    """Raise SolariError for what isn't a whole number from `low` on, up to `high`. what: the start of the message."""
    # True is an int in Python.
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    if not whole or value < low or (high is not None and value > high):
        limits = f"from {low} on" if high is None else f"from {low} to {high}"
        raise SolariError(f"{what} must be a whole number {limits}, not {quoted(value)}")


def refuse_not_finite(array: NDArray[Any]) -> None:
    finite = np.isfinite(array)
    if not finite.all():
        where = tuple(int(i) for i in np.argwhere(~finite)[0])
        raise ValueError(f"must be finite, but element {where} is {array[where]}")


def color(low: float = 0.0, high: float = math.inf) -> Callable[[Any], FloatArray]:
    """A color: three values within a range, one number for gray, or a web color such as "#ff8000" or "orange", which is
    sRGB."""

    def convert(value: ArrayLike) -> FloatArray:
        if isinstance(value, str):
            value = _web_color(value)
        with np.errstate(over="ignore"):
            values = real(value, np.float32)
        if values.shape not in ((), (1,), (3,)):
            why = "; an image belongs in a field for textures, such as base_color_texture" if values.ndim > 1 else ""
            why = "; alpha is a field of its own" if values.shape == (4,) else why
            raise ValueError(f"must be three numbers, or one for gray, not of the shape {values.shape}{why}")
        array = np.array(np.broadcast_to(values, (3,)))
        refuse_not_finite(array)
        if (array < low).any() or (array > high).any():
            raise ValueError(f"must lie between {low:g} and {high:g}, not {array.tolist()}")
        array.setflags(write=False)
        return array

    return convert


def _web_color(text: str) -> list[float]:
    """The linear color of "#rrggbb", "#rgb" or a name of CSS."""
    from PIL import ImageColor  # rarely needed

    if text.lower() in ImageColor.colormap:
        return [float(LINEAR_OF_SRGB[code]) for code in ImageColor.getrgb(text)[:3]]
    digits = text.removeprefix("#")
    if text[:1] != "#" or len(digits) not in (3, 6) or not set(digits) <= set("0123456789abcdefABCDEF"):
        raise ValueError(f"must be three numbers, one for gray, or '#rrggbb' or 'orange', not {quoted(text)}")
    # "#rgb" is short for "#rrggbb".
    pairs = [2 * digit for digit in digits] if len(digits) == 3 else [digits[i : i + 2] for i in (0, 2, 4)]
    return [float(LINEAR_OF_SRGB[int(pair, 16)]) for pair in pairs]


def number(
    low: float = -math.inf, high: float = math.inf, unit: str = "", optional: bool = False, endless: bool = False
) -> Callable[[Any], Any]:
    """A finite number within a range. unit: named in the error. endless: whether infinity counts too."""

    def convert(value: Any) -> float | None:
        if value is None and optional:
            return None
        # An array of one number counts as the number.
        number = float(value.item() if isinstance(value, np.ndarray) and value.size == 1 else value)
        if endless and number == math.inf:
            return number
        if not math.isfinite(number) or not low <= number <= high:
            limits = f"between {low:g} and {high:g}{unit and f' {unit}'}{' or infinite' if endless else ''}"
            raise ValueError(f"must be a finite number {limits}, not {shortened(str(value))}")
        return number

    return convert


def span(low: float, high: float, unit: str) -> Callable[[Any], FloatArray]:
    """Two numbers within a range, (2,), or one for both. unit: named in the error."""

    def convert(value: Any) -> FloatArray:
        values = real(value, np.float64)
        if values.shape not in ((), (2,)):
            raise ValueError(f"must be two numbers, or one for both, not of the shape {values.shape}")
        refuse_not_finite(values)
        if (values < low).any() or (values > high).any():
            raise ValueError(f"must lie between {low:g} and {high:g} {unit}, not {values.tolist()}")
        array = np.array(np.broadcast_to(values, (2,)), np.float32)
        array.setflags(write=False)
        return array

    return convert


def direction(value: ArrayLike) -> FloatArray:
    """A unit vector (3,) from a vector of any length but zero."""
    values = real(value, np.float64)
    if values.shape != (3,):
        raise ValueError(f"must have the shape (3,), not {values.shape}")
    refuse_not_finite(values)
    if not values.any():
        raise ValueError("must not be zero")
    found = unit(values).astype(np.float32)
    found.setflags(write=False)
    return found


def text(value: Any) -> str:
    """A string."""
    if not isinstance(value, str):
        raise TypeError(f"must be a string, not {type(value).__name__}")
    return value


def line(value: Any) -> str:
    """A string without line breaks and other control characters."""
    if not text(value).isprintable():
        raise ValueError(f"must be one line of printable characters, not {value!r}")
    return str(value)


def object_name(value: Any) -> str:
    """The name of an object that has parts, one line."""
    if not isinstance(value, str):
        kind = type(value).__name__
        raise TypeError(
            f"must be a string, the name that the parts of one object share, not {kind}; it is no parent: "
            "scene.group(...) moves objects together"
        )
    return line(value)


def instance_of(kind: Callable[[], type], optional: bool = False) -> Callable[[Any], Any]:
    def convert(value: Any) -> Any:
        if not (optional and value is None) and not isinstance(value, kind()):
            raise TypeError(f"must be a {kind().__name__}, not {type(value).__name__}")
        return value

    return convert


def made_of(kind: Callable[[], type], optional: bool = False) -> Callable[[Any], Any]:
    """An object of a type; an array, a path or another of the scene's objects is passed to the type's constructor."""

    def convert(value: Any) -> Any:
        if (optional and value is None) or isinstance(value, kind()):
            return value
        if not isinstance(value, (np.ndarray, str, os.PathLike, Checked)):
            raise TypeError(f"must be a {kind().__name__}, an array of pixels or a path, not {type(value).__name__}")
        return kind()(value)

    return convert


def affine_transform(value: ArrayLike) -> NDArray[np.float64]:
    """A read-only affine, invertible matrix (4, 4), from such a matrix, its first 3 rows, or a position (3,)."""
    matrix = _affine(value)
    if not _is_invertible(matrix):
        raise ValueError("must be invertible: no axis may have a scale of 0, and the axes may not lie in one plane")
    return matrix


def placing_transform(value: ArrayLike) -> NDArray[np.float64]:
    """The same for surfaces, which it may flatten: they get a thickness of a ten-thousandth, since rays and normals
    need an inverse."""
    matrix = _affine(value)
    if not _is_invertible(matrix):
        matrix = thickened(matrix)
        matrix.setflags(write=False)
        if not _is_invertible(matrix):
            raise ValueError("must leave an area: only one axis may have a scale of 0")
    return matrix


def _affine(value: ArrayLike) -> NDArray[np.float64]:
    values = real(value, np.float64)
    if values.shape not in ((4, 4), (3, 4), (3,)):
        raise ValueError(f"must have the shape (4, 4), (3, 4) or, for a position, (3,), not {values.shape}")
    refuse_not_finite(values)
    matrix = np.eye(4)
    if values.ndim == 1:
        matrix[:3, 3] = values
    else:
        matrix[: values.shape[0]] = values
    last = matrix[3].tolist()
    if last != [0.0, 0.0, 0.0, 1.0]:
        raise ValueError(f"must be affine, with the last row 0 0 0 1, not {last}")
    if np.abs(matrix).max() > LARGEST_TRANSFORM:
        raise ValueError(f"must lie within {LARGEST_TRANSFORM:g}, or floats overflow on the device")
    matrix.setflags(write=False)
    return matrix


def _is_invertible(matrix: NDArray[np.float64]) -> bool:
    # Plain floats are faster here, which matters for scenes of 100,000 instances.
    (a, b, c, _), (d, e, f, _), (g, h, i, _), _ = matrix.tolist()
    # Compared with the box that the axes would span at right angles, so that small scales aren't singular.
    lengths = math.hypot(a, d, g) * math.hypot(b, e, h) * math.hypot(c, f, i)
    determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    return bool(abs(determinant) > 1e-9 * lengths)  # also if an axis has zero length


def joint_matrices(value: Any) -> NDArray[np.float64] | None:
    """Read-only affine matrices (J, 3, 4) from such matrices or from (J, 4, 4), whose last rows don't count."""
    if value is None:
        return None
    values = real(value, np.float64)
    if values.ndim == 3 and values.shape[1:] == (4, 4):
        values = values[:, :3]
    found: NDArray[np.float64] = array(None, 3, 4, dtype=np.float64, max_abs=LARGEST_TRANSFORM)(values)
    return found


def one_of(choices: tuple[str, ...]) -> Callable[[Any], str]:
    def convert(value: Any) -> str:
        if not isinstance(value, str) or value not in choices:
            raise ValueError(f"must be one of {', '.join(choices)}, not {quoted(value)}")
        return str(value)

    return convert
