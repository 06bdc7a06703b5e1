"""The 24 bytes of a light tile's sample, decoded in float64, and what it then sends to a place."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating[Any]]


def decode_octahedral(codes: NDArray[np.integer[Any]], bits: int = 16) -> Floats:
    """Unit vectors (..., 3) of codes of two numbers (Cigolle et al. 2014); the largest code but one is 1, so that axes
    are exact."""
    mask = (1 << bits) - 1
    square = np.stack([codes & mask, codes >> bits & mask], axis=-1) / (mask - 1) * 2 - 1
    z = 1 - np.abs(square).sum(axis=-1, keepdims=True)
    folded = np.where(z >= 0, square, (1 - np.abs(square[..., ::-1])) * np.where(square >= 0, 1, -1))
    along = np.concatenate([folded, z], axis=-1)
    found: Floats = along / np.linalg.norm(along, axis=-1, keepdims=True)
    return found


def decode_rgb9e5(bits: NDArray[np.integer[Any]]) -> Floats:
    """Colours (..., 3) of 9 bits a channel and 5 of exponent (EXT_texture_shared_exponent)."""
    mantissas = np.stack([bits >> shift & 511 for shift in (0, 9, 18)], axis=-1)
    found: Floats = np.ldexp(mantissas.astype(np.float64), (bits >> 27).astype(np.int32)[..., None] - 24)
    return found


def half_step(colors: Floats) -> Floats:
    """Half of the distance (N, 1) between neighbours in rgb9e5 around colours (N, 3)."""
    _, exponent = np.frexp(colors.max(axis=-1, keepdims=True))  # of a mantissa from 1/2 to 1
    found: Floats = np.ldexp(1.0, np.maximum(exponent - 1, -16) - 9)
    return found


def step_and_rounding(logarithms: Floats) -> Floats:
    """What packing may add to log2(1 + x) (N, 3): half a step, and what Vulkan lets log2 and the sum be off by."""
    found: Floats = half_step(logarithms) + np.maximum(2.0**-21 + 2.0**-23, 2.0**-21 * logarithms)
    return found


class LightSamples(NamedTuple):
    """Decoded samples; `position` is a direction where `directional`, and radiance is in units of white."""

    position: Floats
    normal: Floats
    exposed: Floats
    inverse_pdf: Floats
    directional: NDArray[np.bool_]


def decode(packed: NDArray[Any]) -> LightSamples:
    """Records (N,) of a renderer's `light_tiles`, whose radiance is log2(1 + radiance * exposure)."""
    inverse_pdf = packed["inverse_pdf"].astype(np.float64)
    return LightSamples(
        packed["world_position"].astype(np.float64),
        decode_octahedral(packed["world_normal"]),
        np.exp2(decode_rgb9e5(packed["radiance"])) - 1,
        np.abs(inverse_pdf),
        inverse_pdf < 0,
    )


def receive(samples: LightSamples, points: Floats) -> tuple[Floats, Floats]:
    """Directions (N, 3) in which points (N, 3) see the samples, and irradiance (N, 1) but for their cosine there of
    radiance 1, inverse pdf included."""
    to_light = samples.position - np.where(samples.directional[:, None], 0, points)
    squared = (to_light**2).sum(axis=-1, keepdims=True)
    wi = to_light / np.sqrt(squared)
    cosine = np.maximum(-(wi * samples.normal).sum(axis=-1, keepdims=True), 0)
    return wi, cosine / squared * samples.inverse_pdf[:, None]
