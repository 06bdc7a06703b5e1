"""Measurements of the conformance suite in tests: all must hold, or some rules must fail."""

from __future__ import annotations


def hold(measurements):
    """Each measurement keeps its bar; returns the measurements."""
    found = list(measurements)
    for measured in found:
        print(measured)
    assert found, "nothing was measured"
    assert not [str(measured) for measured in found if not measured.holds]
    return found
