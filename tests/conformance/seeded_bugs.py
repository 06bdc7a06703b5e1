"""Seeded bugs, and the rules that must be red with them. Every rule of the suite has one."""

from __future__ import annotations

import numpy as np


def failing(measurements):
    """The names of the rules that don't hold."""
    return {measured.rule.name for measured in measurements if not measured.holds}


def expect_red(measurements, *parts):
    """Each part is in the name of a rule that fails."""
    names = failing(measurements)
    for part in parts:
        assert any(part in name for name in names), f"{part} must fail; what fails is {sorted(names)}"


def masked(field, mask):
    """Damage to instance records: only these bits of a field are left."""

    def damage(records):
        records[field] &= np.uint32(mask)

    return damage
