"""Assertions on measurements of the conformance suite."""


def hold(measurements):
    """Require that all measurements hold, and return them."""
    found = list(measurements)
    for measured in found:
        print(measured)
    assert found, "nothing was measured"
    assert not [str(measured) for measured in found if not measured.holds]
    return found
