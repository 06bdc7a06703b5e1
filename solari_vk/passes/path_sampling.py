"""How the reference path tracer samples paths and pixels."""

from __future__ import annotations

from solari_vk.gpu.shaders.headers import enumeration

LIGHT_STRATEGIES = ("mis", "nee", "brdf")
"""mis: light samples and BRDF samples, weighted against each other. nee: light samples alone (next event estimation).
brdf: only the lights that scattered rays meet. All have the same mean."""
PIXEL_FILTERS = {"box": 0.5, "gaussian": 2.0, "blackman_harris": 1.5}
"""The radius of each filter in pixels. The Gaussian's standard deviation is a quarter of its radius."""


def glsl_header() -> str:
    """`const uint LIGHT_STRATEGY_MIS = 0u;`, `const uint PIXEL_FILTER_BOX = 0u;` and so on."""
    return enumeration("LIGHT_STRATEGY", LIGHT_STRATEGIES) + "\n" + enumeration("PIXEL_FILTER", PIXEL_FILTERS)
