"""How the reference path tracer samples paths and pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from solari_vk.gpu.shaders.headers import enumeration

LIGHT_STRATEGIES = ("mis", "nee", "brdf")
"""mis: multiple importance sampling of light samples and BRDF samples. nee: next event estimation, light samples alone.
brdf: BRDF samples alone. All have the same mean."""
_SEED_STEP = 0x9E3779B9  # odd, so that the seeds of 2^32 pictures differ
PIXEL_FILTERS = {"box": 0.5, "gaussian": 2.0, "blackman_harris": 1.5}
"""The radius of each filter in pixels. The Gaussian's standard deviation is a quarter of its radius."""


def glsl_header() -> str:
    """`const uint LIGHT_STRATEGY_MIS = 0u;`, `const uint PIXEL_FILTER_BOX = 0u;` and so on."""
    return enumeration("LIGHT_STRATEGY", LIGHT_STRATEGIES) + "\n" + enumeration("PIXEL_FILTER", PIXEL_FILTERS)


def numbered_seed(seed: int, number: int) -> int:
    """The seed of one of many pictures with independent noise; picture 0 has `seed` itself."""
    return (seed + number * _SEED_STEP) % 2**32


def numbered_seeds(seed: int, count: int) -> NDArray[np.uint32]:
    """`numbered_seed` of the pictures from 0 to count - 1."""
    return (seed + np.arange(count, dtype=np.uint64) * _SEED_STEP).astype(np.uint32)
