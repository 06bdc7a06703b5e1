"""Numbers in [0, 1) that cover it evenly, of which any number of first ones does."""

from __future__ import annotations

# Shares of 2^64, for exact steps however large a number is: the golden ratio's fraction; the inverse of the real root
# of x^3 = x + 1, and its square.
GOLDEN_STEP = 0x9E3779B97F4A7C15
PLASTIC_STEPS = 0xC13FA9A902A6328F, 0x91E10DA5C79E7B1D


def additive(number: int, step: int) -> float:
    """1/2 + number * step, without whole parts. Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences"
    (2018)."""
    return ((2**63 + number * step) % 2**64 >> 11) / 2**53


def radical_inverse(number: int, base: int) -> float:
    """Van der Corput (1935), Halton (1964): a number's digits behind the point, the last one first."""
    result = 0.0
    part = 1.0
    while number:
        part /= base
        result += part * (number % base)
        number //= base
    return result
