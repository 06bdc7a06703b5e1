"""Arrays as the elements of a shader's buffer."""

from __future__ import annotations

from typing import Any

import numpy as np

from solari_vk.base.errors import SolariError, quoted


def converted(name: str, values: Any, dtype: np.dtype[Any], shape: tuple[int, ...]) -> np.ndarray[Any, Any]:
    """Values as elements of this type, at most as many as `shape` begins with. Raises SolariError, which names both
    types, for what doesn't fit."""
    try:
        given = np.asarray(values)
    except (TypeError, ValueError) as error:
        raise SolariError(f"{name}: {quoted(values)} is no array: {error}") from None
    if shape and given.shape == (0,):
        return np.empty((0, *shape[1:]), dtype)
    kind = f"{dtype}, {shape[1:]} each" if shape[1:] else f"{dtype}"
    if shape[1:] != given.shape[1:] or (not shape and given.ndim):
        raise SolariError(f"{name}: the shape of the array is {given.shape}; the shader's elements are {kind}")
    if shape and (not given.ndim or len(given) > shape[0]):
        raise SolariError(f"{name}: the buffer has {shape[0]:,} elements, and the shape of the array is {given.shape}")
    if given.dtype == dtype:
        return np.ascontiguousarray(given)
    known = {"f": "fiu", "i": "iu", "u": "iu"}.get(dtype.kind, "")
    if given.dtype.kind not in known:
        raise SolariError(f"{name}: the array is of {given.dtype}, and the shader's elements are {kind}")
    with np.errstate(over="ignore", invalid="ignore"):
        made = given.astype(dtype)
    beyond = np.isinf(made) & np.isfinite(given) if dtype.kind == "f" else made != given
    if beyond.any():
        raise SolariError(f"{name}: the array has numbers beyond the range of the shader's elements, {kind}")
    return np.ascontiguousarray(made)
