"""The record of a light tile's sample, decoded in float64, and the light that it sends to a point."""

from typing import NamedTuple

import numpy as np

from solari_vk.bound.lights.light_kinds import KIND_INDEX
from support.oracles.encodings import decode_octahedral, decode_rgb9e5


def half_step(colors):
    """Half of the distance (N, 1) between neighbors in rgb9e5 around colors (N, 3)."""
    _, exponent = np.frexp(colors.max(axis=-1, keepdims=True))  # of a mantissa from 1/2 to 1
    return np.ldexp(1.0, np.maximum(exponent - 1, -16) - 9)


def step_and_rounding(logarithms):
    """The error that packing may add to log2(1 + x) (N, 3): half a step, and Vulkan's tolerances."""
    return half_step(logarithms) + np.maximum(2.0**-21 + 2.0**-23, 2.0**-21 * logarithms)


class LightSamples(NamedTuple):
    """Decoded samples; `position` is a direction where `directional`, and radiance is in units of white."""

    position: np.ndarray
    normal: np.ndarray
    exposed: np.ndarray
    inverse_area_pdf: np.ndarray
    directional: np.ndarray


def decode(packed):
    """Records (N,) of a renderer's `light_tiles`, whose radiance is log2(1 + radiance * exposure)."""
    return LightSamples(
        packed["world_position"].astype(np.float64),
        decode_octahedral(packed["world_normal"]),
        np.exp2(decode_rgb9e5(packed["radiance"])) - 1,
        packed["inverse_area_pdf"].astype(np.float64),
        packed["kind"] == KIND_INDEX["directional"],
    )


def receive(samples, points):
    """Directions (N, 3) from points (N, 3) to the samples, and the irradiance (N, 1) of samples of radiance 1.

    The irradiance includes the inverse pdf, but not the cosine at the points."""
    to_light = samples.position - np.where(samples.directional[:, None], 0, points)
    squared = (to_light**2).sum(axis=-1, keepdims=True)
    wi = to_light / np.sqrt(squared)
    cosine = np.maximum(-(wi * samples.normal).sum(axis=-1, keepdims=True), 0)
    return wi, cosine / squared * samples.inverse_area_pdf[:, None]
