"""White furnace: a white surface in white light sends back all of it, whatever its roughness, metallic and angle."""

from __future__ import annotations

import numpy as np
import pytest

from solari_vk.conformance.brdf_checks import furnace, measure_furnace


def check(shaders, metallic):
    (measured,) = measure_furnace(shaders, metallic)
    assert measured.holds, str(measured)


@pytest.mark.parametrize("metallic", [0.0, 0.5, 1.0])
def test_white_furnace(shaders, metallic):
    check(shaders, metallic)


def test_solaris_layerings_are_off_as_told(shaders):
    """0.18 adds both lobes and gains, 0.19 multiplies Fresnel terms and loses."""
    gain = furnace(shaders, 0.0, brdf_layering=1)
    loss = furnace(shaders, 0.0, brdf_layering=2)
    assert 1.4 < gain.max() < 1.7
    assert 0.3 < loss.min() < 0.5


def test_lambert_switch(shaders):
    assert np.abs(furnace(shaders, 0.5, brdf_lambert=True) - 1).max() < 1e-5
