"""How often light samples take each light, before it is known where they are needed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.lights.light_kinds import KIND_INDEX

EQUAL_SHARE = 0.5
"""The share of light samples that takes all lit lights with equal probability, for weak lights that are near and for
strong ones behind walls, such as the sun: no light is taken less than half as often as by either rule alone."""
PORTAL_SHARE = 0.5
"""The share of the light samples of environments that goes through portals: in rooms all should, elsewhere none, and
which receivers are in rooms isn't known. Samples of all other lights are as many as without portals."""


def choice_weights(powers: NDArray[np.float64]) -> NDArray[np.float64]:
    """How often light samples take lights of these powers (N,), up to a factor; dark lights are never taken."""
    lit = powers > 0
    highest = powers.max(initial=0.0)
    if not highest > 0:
        return powers
    shares = powers / highest
    weights: NDArray[np.float64] = (1 - EQUAL_SHARE) * shares / shares.sum() + EQUAL_SHARE * lit / np.count_nonzero(lit)
    return weights


def choice_weights_by_kind(powers: NDArray[np.float64], kinds: NDArray[np.uint32]) -> NDArray[np.float64]:
    """The same for lights of these kinds (N,), of which portals take their share from environments, by their power."""
    portal, environment = (kinds == KIND_INDEX[name] for name in ("portal", "environment"))
    weights = choice_weights(np.where(portal, 0.0, powers))
    if (through := powers[portal].sum()) > 0:
        weights[portal] = PORTAL_SHARE * weights[environment].sum() * powers[portal] / through
        weights[environment] *= 1 - PORTAL_SHARE
    return weights
