"""Draws from the surface model against its own density and values; reciprocity; no NaN anywhere."""

from __future__ import annotations

import numpy as np
import pytest

from solari_vk.conformance import brdf_runs
from solari_vk.conformance.brdf_checks import CASES, drawn_cells, random_directions, random_materials
from solari_vk.measure.statistics import chi_squared_p, sidak

COUNT = 1_000_000


def check_density(shaders, roughness, metallic, degrees):
    material = brdf_runs.materials(0.8, 0.5, metallic, roughness)
    wo = brdf_runs.direction(degrees)
    rows = brdf_runs.run(shaders, "draw", COUNT, material, wo)
    assert not np.isnan(rows).any()
    wi, weight, pdf, drawn_pdf, value = rows[:, 0], rows[:, 1], rows[:, 2, 0], rows[:, 2, 1], rows[:, 3]

    mirrored = np.isinf(drawn_pdf)
    if roughness == 0:
        assert np.abs(wi[mirrored] - wo * (-1, -1, 1)).max() < 1e-6
        probability = rows[0, 2, 2]
        share = mirrored.mean()
        assert abs(share - probability) < 5 * np.sqrt(probability / COUNT)
        fresnel = 0.04 + 0.96 * (1 - wo[2]) ** 5
        assert np.abs(weight[mirrored] * probability / fresnel - 1).max() < 1e-5
    else:
        assert not mirrored.any()
    valid = ~mirrored & (wi[:, 2] > 0)
    assert (weight[~mirrored & ~valid] == 0).all()
    assert np.abs(np.linalg.norm(wi[valid], axis=1) - 1).max() < 1e-5
    assert (pdf[valid] > 0).all()
    assert np.abs(weight[valid] * pdf[valid, None] / np.maximum(value[valid], 1e-20) - 1).max() < 2e-3
    assert np.allclose(drawn_pdf[valid], pdf[valid], rtol=1e-3)

    scale = max(roughness**2, 0.3 if metallic < 1 else 0.0)
    observed, expected = drawn_cells(shaders, material, wo, wi[valid], scale, COUNT)
    assert chi_squared_p(observed, expected) > sidak(0.01, len(CASES))


@pytest.mark.parametrize(("roughness", "metallic", "degrees"), CASES)
def test_draws_follow_the_density(shaders, roughness, metallic, degrees):
    check_density(shaders, roughness, metallic, degrees)


def check_finite(shaders):
    rng = np.random.default_rng(5)
    count = COUNT
    records = random_materials(rng, count)
    wo, wi = random_directions(rng, count), random_directions(rng, count)
    below = rng.random(count) < 0.1
    wi[below] *= -1
    rows = brdf_runs.run(shaders, "evaluate", count, records, wo, wi)
    assert np.isfinite(rows).all()
    assert (rows[:, 1:] >= 0).all()
    assert (rows[below][:, [1, 3]] == 0).all()
    drawn = brdf_runs.run(shaders, "draw", count, records, wo)
    assert not np.isnan(drawn).any()
    assert np.isfinite(drawn[:, 1]).all()
    assert (drawn[:, 1] >= 0).all()
    assert drawn[:, 1].max() < 30, "one draw's weight stays near the albedo over the chance of its lobe"


def test_finite_everywhere(shaders):
    check_finite(shaders)


def check_reciprocity(shaders):
    """Of diffuse, and of specular without its multi-scattering factor, which belongs to the view."""
    rng = np.random.default_rng(6)
    count = 20_000
    records = random_materials(rng, count)
    records["perceptual_roughness"] = rng.uniform(0.1, 1, count)
    wo, wi = random_directions(rng, count, 0), random_directions(rng, count, 0)
    there, back = brdf_runs.run(shaders, "evaluate", count, records, wo, wi), None
    back = brdf_runs.run(shaders, "evaluate", count, records, wi, wo)
    diffuse, returned = there[:, 1] / wi[:, 2:], back[:, 1] / wo[:, 2:]
    assert np.allclose(diffuse, returned, rtol=1e-4, atol=1e-7)
    # F0 = 0 has no factor
    records["metallic"], records["reflectance"] = 0, 0
    there, back = (
        brdf_runs.run(shaders, "evaluate", count, records, a, b)[:, 3] / b[:, 2:] for a, b in ((wo, wi), (wi, wo))
    )
    assert np.allclose(there, back, rtol=1e-3, atol=1e-7)


def test_reciprocity(shaders):
    check_reciprocity(shaders)
