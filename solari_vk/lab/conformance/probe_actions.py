"""Bits that say what a ray-query probe does at candidates; they can be combined."""

from __future__ import annotations

from solari_vk.gpu.shaders.headers import constants

PASS_OVER = 0
"""Ignore the candidate and continue."""
CONFIRM = 1
"""Confirm candidate triangles."""
CONFIRM_ODD = 2
"""Confirm candidate triangles with an odd primitive index, as an alpha test would."""
GENERATE_AT = 4
"""Generate a hit of candidate boxes at t = the probe's parameter."""
GENERATE_SPHERE = 8
"""Generate a hit where the ray meets the ball of radius 0.5 in each unit box."""
TERMINATE = 16
"""End the query at the first candidate, after the actions of the other bits."""

NEARER = 32
"""With GENERATE_AT: each hit is 1 nearer than the previous one, so that the last one is committed."""
FARTHER = 64
"""With GENERATE_AT: each hit is 1 farther than the previous one, so that the first one stays committed."""
STEP_LIMIT = 4096
"""Not a bit: a probe stops after this many candidates, so that an endless traversal is reported instead of hanging."""


def glsl_header() -> str:
    """The actions as GLSL constants with the same names."""
    return constants(**{name: value for name, value in globals().items() if name.isupper()})
