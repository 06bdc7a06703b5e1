"""What tests with damaged rays, records and shaders share: which rules fail, and damage."""

from __future__ import annotations

import numpy as np


def failing(measurements):
    """The names of the rules that fail."""
    return {measured.rule.name for measured in measurements if not measured.holds}


def expect_red(measurements, *parts):
    """Require that each part occurs in the name of a failing rule."""
    names = failing(measurements)
    for part in parts:
        assert any(part in name for name in names), f"{part} must fail; what fails is {sorted(names)}"


def masked(field, mask):
    """Damage: clears all bits of a field outside the mask."""

    def damage(sent):
        sent[field] &= np.uint32(mask & 0xFFFFFFFF)

    return damage


def with_bits(field, bits):
    """Damage: sets these bits of a field."""

    def damage(sent):
        sent[field] |= np.uint32(bits)

    return damage


def changed(**values):
    """Damage: other values of fields."""

    def damage(sent):
        for field, value in values.items():
            sent[field] = value

    return damage
