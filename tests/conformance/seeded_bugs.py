"""What tests with seeded bugs share: which rules fail. Every rule of the suite fails with some bug."""

from __future__ import annotations

import numpy as np
import pytest
from support.patches import patched_shaders

from solari_vk.conformance.rules import Rule


def failing(measurements):
    """The names of the rules that fail."""
    return {measured.rule.name for measured in measurements if not measured.holds}


def rules_of(module):
    """The names of the rules that are constants of a module."""
    return {rule.name for rule in vars(module).values() if isinstance(rule, Rule)}


def rules_broken_by(bugs):
    """The names of the rules that a table of bugs, as expect_noticed takes them, breaks."""
    return {name for _, found, *_ in bugs.values() for name in found}


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


def marked(bugs, quick):
    """The names of seeded bugs as parameters of a test, of which those not in `quick` are slow."""
    return [pytest.param(name, marks=[] if name in quick else [pytest.mark.slow]) for name in bugs]


def expect_noticed(device, bug):
    """Checks that rules fail with a bug. bug: (a function that measures, the rules' names, file, old, new text)."""
    measure, rules, *patch = bug
    with patched_shaders(tuple(patch)):
        expect_red(measure(device), *rules)
