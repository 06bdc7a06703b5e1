"""What tests with damaged rays, records and shaders share: which rules fail."""

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
    """Damage to instance records: clears all bits of a field outside the mask."""

    def damage(records):
        records[field] &= np.uint32(mask)

    return damage
