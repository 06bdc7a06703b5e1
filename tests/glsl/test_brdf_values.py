"""Values of the surface model for single directions, against the NumPy reference, which was written independently."""

from __future__ import annotations

import numpy as np
import pytest
from support.brdf import Surface, alpha_of, directional_albedo_terms
from support.older_solari import LOBES_ADDED

from solari_vk.conformance import brdf_runs
from solari_vk.conformance.brdf_checks import furnace, random_directions

CASES = [
    # base color, metallic, perceptual roughness, reflectance, and the error allowed for the table's interpolation
    (0.8, 0.0, 0.3, 0.5, 2e-3),
    (0.8, 0.0, 0.9, 1.0, 2e-3),
    (0.6, 1.0, 0.2, 0.5, 2e-3),
    (0.9, 1.0, 1.0, 0.5, 2e-3),
    (0.5, 0.5, 0.6, 0.7, 2e-3),
    (0.8, 0.0, 0.1, 1.0, 1e-2),
]


@pytest.mark.parametrize(("base_color", "metallic", "roughness", "reflectance", "bar"), CASES)
def test_values(shaders, base_color, metallic, roughness, reflectance, bar):
    rng = np.random.default_rng(1)
    count = 2000
    wo, wi = random_directions(rng, count), random_directions(rng, count)
    # half of them near the mirror direction, where a smooth surface shines
    wi[::2] = wo[::2] * (-1, -1, 1) + 0.1 * rng.normal(size=(count // 2, 3))
    wi /= np.linalg.norm(wi, axis=1, keepdims=True)
    inside = (wo[:, 2] > 0.05) & (wi[:, 2] > 0.05)
    wo, wi = wo[inside].astype(np.float32), wi[inside].astype(np.float32)
    material = brdf_runs.materials(base_color, reflectance, metallic, roughness)
    rows = brdf_runs.run(shaders, "evaluate", len(wo), material, wo, wi)
    seen = rows[:, 1] + rows[:, 3]
    surface = Surface(base_color, metallic, roughness, reflectance)
    expected = surface.value(wo.astype(float), wi.astype(float)) * wi[:, 2:]
    assert np.abs(seen / expected - 1).max() < bar


def test_table_holds_the_albedo(shaders):
    """Nodes of the table against brute force; the cosine is the square of the column's relative position."""
    table = shaders.brdf_tables()["brdf_table"].read(np.float32).reshape(64, 64, 2)
    for row in (8, 20, 40, 63):
        for column in (12, 30, 63):
            a, b = directional_albedo_terms(alpha_of(row / 63), (column / 63) ** 2)
            np.testing.assert_allclose(table[row, column], (a, b), atol=1e-3)


def test_solaris_layerings_have_the_known_errors(shaders, patched):
    """Solari 0.18 adds both lobes, which gains energy; 0.19 multiplies Fresnel terms, which loses energy."""
    with patched(*LOBES_ADDED) as adding:
        assert 1.4 < furnace(adding, 0.0, brdf_layering=1).max() < 1.7
    assert 0.3 < furnace(shaders, 0.0, brdf_layering=1).min() < 0.5


def test_lambert_switch(shaders):
    assert np.abs(furnace(shaders, 0.5, brdf_lambert=True) - 1).max() < 1e-5
