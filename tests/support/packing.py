"""Number formats and hashes in plain integers and float64."""

from __future__ import annotations

import math

import numpy as np

MASK = 0xFFFFFFFF


def pcg_step(state):
    """The 32-bit LCG of PCG (O'Neill 2014) as in Jarzynski and Olano 2020."""
    return (state * 747796405 + 2891336453) & MASK


def pcg_output(state):
    """The RXS-M-XS permutation of one state."""
    word = (((state >> ((state >> 28) + 4)) ^ state) * 277803737) & MASK
    return (word >> 22) ^ word


def pcg_hash(value):
    """pcg(v) of Jarzynski and Olano: one step, then the permutation."""
    return pcg_output(pcg_step(value & MASK))


def rgb9e5_encode(color):
    """EXT_texture_shared_exponent (OpenGL 4.6, 18.4.3): red in the low bits, the exponent in the high 5."""
    bits, bias, largest = 9, 15, 511 / 512 * 2.0**16
    clamped = [min(max(float(c), 0.0), largest) if not math.isnan(c) else 0.0 for c in color]
    top = max(clamped)
    exponent = max(-bias - 1, math.floor(math.log2(top)) if top > 0 else -bias - 1) + 1 + bias
    if math.floor(top / 2.0 ** (exponent - bias - bits) + 0.5) == 2**bits:
        exponent += 1
    values = [math.floor(c / 2.0 ** (exponent - bias - bits) + 0.5) for c in clamped]
    return values[0] | values[1] << 9 | values[2] << 18 | exponent << 27


def rgb9e5_decode(packed):
    scale = 2.0 ** ((packed >> 27) - 15 - 9)
    return np.array([(packed >> shift & 511) * scale for shift in (0, 9, 18)])


def octahedral_encode(direction):
    """A unit vector (3,) to the square [-1, 1]^2 (Cigolle et al. 2014)."""
    x, y, z = np.asarray(direction, np.float64) / np.abs(direction).sum()
    if z < 0:
        x, y = (1 - abs(y)) * math.copysign(1, x), (1 - abs(x)) * math.copysign(1, y)
    return np.array((x, y))


def octahedral_decode(square):
    x, y = square
    z = 1 - abs(x) - abs(y)
    if z < 0:
        x, y = (1 - abs(y)) * math.copysign(1, x), (1 - abs(x)) * math.copysign(1, y)
    direction = np.array((x, y, z))
    return direction / np.linalg.norm(direction)
