"""White furnace: a white surface in white light sends back all of it, whatever its roughness, metallic and angle."""

from __future__ import annotations

import brdf_runs
import numpy as np
import pytest

BAR = 0.005
ROUGHNESS = np.concatenate([np.linspace(0, 0.12, 41), np.linspace(0.125, 1, 36)]).astype(np.float32)
DEGREES = [0, 10, 25, 40, 55, 65, 72, 77, 80, 82, 84, 85]


def furnace(shaders, metallic, **constants):
    """Albedo (roughness, angle) of white."""
    wo = np.tile([brdf_runs.direction(d) for d in DEGREES], (len(ROUGHNESS), 1))
    roughness = np.repeat(ROUGHNESS, len(DEGREES))
    albedo = brdf_runs.albedo(shaders, brdf_runs.materials(metallic=metallic, roughness=roughness), wo, **constants)
    assert np.isfinite(albedo).all()
    assert np.ptp(albedo, axis=1).max() < 1e-6
    return albedo[:, 0].reshape(len(ROUGHNESS), len(DEGREES))


def check(shaders, metallic):
    worst = np.abs(furnace(shaders, metallic) - 1)
    where = np.unravel_index(worst.argmax(), worst.shape)
    assert worst.max() < BAR, f"roughness {ROUGHNESS[where[0]]}, {DEGREES[where[1]]} degrees: {worst.max()}"


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
