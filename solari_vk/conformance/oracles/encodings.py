"""Hashes, random numbers and packed formats in numpy, written from the papers and never from the shaders."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Words = NDArray[np.uint32]
Floats = NDArray[np.floating[Any]]
RGB9E5_MAX = 65408.0


# ---- PCG: O'Neill 2014; Jarzynski and Olano 2020 ----------------------------------------------------


def _words(values: ArrayLike) -> Words:
    return np.asarray(values).astype(np.uint32)


def pcg_step(state: ArrayLike) -> Words:
    """The generator's next states."""
    return np.asarray(_words(state) * _words([747796405]) + _words([2891336453])[0])


def pcg_output(state: ArrayLike) -> Words:
    """The generator's output for its states (the RXS-M-XS permutation)."""
    words = _words(state)
    mixed = ((words >> ((words >> 28) + 4)) ^ words) * _words([277803737])
    return np.asarray((mixed >> 22) ^ mixed)


def pcg_hash(values: ArrayLike) -> Words:
    """pcg: one step, then the output."""
    return pcg_output(pcg_step(values))


def pcg3d(values: ArrayLike) -> Words:
    """Hashes (..., 3) of words (..., 3)."""
    return _mix(values, ((0, 1, 2), (1, 2, 0), (2, 0, 1)))


def pcg4d(values: ArrayLike) -> Words:
    """Hashes (..., 4) of words (..., 4)."""
    return _mix(values, ((0, 1, 3), (1, 2, 0), (2, 0, 1), (3, 1, 2)))


def _mix(values: ArrayLike, rounds: Iterable[tuple[int, int, int]]) -> Words:
    v = _words(values) * _words([1664525]) + _words([1013904223])
    for last in (False, True):
        for target, a, b in rounds:
            v[..., target] += v[..., a] * v[..., b]
        if not last:
            v ^= v >> 16
    return v


# ---- packed formats ---------------------------------------------------------------------------------


def encode_rgb9e5(colors: ArrayLike) -> Words:
    """Codes (...) of colors (..., 3) (EXT_texture_shared_exponent, rounding to the nearest)."""
    clamped = np.clip(np.asarray(colors, np.float64), 0, RGB9E5_MAX)
    largest = clamped.max(axis=-1, keepdims=True)
    exponent = np.maximum(-16, np.floor(np.log2(np.maximum(largest, 1e-30))).astype(int)) + 16
    exponent += np.floor(np.ldexp(largest, 24 - exponent) + 0.5) == 512
    mantissas = _words(np.floor(np.ldexp(clamped, 24 - exponent) + 0.5))
    return _words((mantissas << _words((0, 9, 18))).sum(axis=-1) + (exponent[..., 0] << 27))


def decode_rgb9e5(codes: NDArray[np.integer[Any]]) -> Floats:
    """Colors (..., 3) of 9 bits a channel and 5 of exponent (EXT_texture_shared_exponent)."""
    mantissas = np.stack([codes >> shift & 511 for shift in (0, 9, 18)], axis=-1)
    return np.asarray(mantissas * rgb9e5_step(codes)[..., None])


def rgb9e5_step(codes: NDArray[np.integer[Any]]) -> Floats:
    """The distance between neighboring values of each code's channels."""
    return np.asarray(np.ldexp(1.0, (codes >> 27).astype(np.int32) - 24))


def decode_octahedral(codes: NDArray[np.integer[Any]], bits: int = 16) -> Floats:
    """Unit vectors (..., 3) from codes of two numbers with this many bits each (Cigolle et al. 2014).

    The largest code but one is 1, so that axes are exact.
    """
    mask = (1 << bits) - 1
    square = np.stack([codes & mask, codes >> bits & mask], axis=-1) / (mask - 1) * 2 - 1
    z = 1 - np.abs(square).sum(axis=-1, keepdims=True)
    folded = np.where(z >= 0, square, (1 - np.abs(square[..., ::-1])) * np.where(square >= 0, 1, -1))
    along = np.concatenate([folded, z], axis=-1)
    return np.asarray(along / np.linalg.norm(along, axis=-1, keepdims=True))
