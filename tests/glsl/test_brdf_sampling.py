"""Draws from the surface model against its own density and values; reciprocity; no NaN anywhere."""

from __future__ import annotations

import brdf_runs
import numpy as np
import pytest
from chi_squared import level, p_value

COUNT = 1_000_000
CELLS = (24, 32)  # of slope and turn of the half vector
FINE = 12  # points a cell each way for the expected counts
CASES = [  # perceptual roughness, metallic, degrees
    (0.04, 1.0, 30.0),
    (0.1, 1.0, 80.0),
    (0.3, 1.0, 5.0),
    (0.5, 1.0, 60.0),
    (1.0, 1.0, 85.0),
    (0.2, 0.0, 40.0),
    (0.6, 0.0, 75.0),
    (0.5, 0.5, 20.0),
    (0.0, 0.0, 50.0),
]


def half_to_incoming(slope, turn, wo):
    """wi (N, 3) for half vectors by the tangent of their tilt and their turn, and the solid angle of wi per
    d(slope) d(turn)."""
    cos_h = 1 / np.sqrt(1 + slope**2)
    half = np.stack([slope * np.cos(turn), slope * np.sin(turn), np.ones_like(slope)], axis=-1) * cos_h[..., None]
    along = half @ wo
    return 2 * along[..., None] * half - wo, 4 * np.abs(along) * cos_h**3 * slope


def expected_shares(shaders, material, wo, scale):
    """Probability of each cell (CELLS) from brdf_pdf: Gauss in the slope up to where wi sets, midpoints in the turn."""
    wo = wo.astype(np.float64)
    nodes, weights = np.polynomial.legendre.leggauss(FINE)
    turn = 2 * np.pi * (np.arange(CELLS[1] * FINE) + 0.5) / (CELLS[1] * FINE)
    towards = wo[0] * np.cos(turn) + wo[1] * np.sin(turn)
    horizon = np.arctan((towards + np.hypot(towards, wo[2])) / wo[2] / scale) * 2 / np.pi
    edges = np.minimum(np.arange(CELLS[0] + 1)[:, None] / CELLS[0], horizon)  # (cells + 1, turns)
    width = np.diff(edges, axis=0)[:, None]
    q = edges[:-1, None] + width * (nodes[:, None] + 1) / 2  # (cells, nodes, turns)
    slope = scale * np.tan(q * np.pi / 2)
    d_slope = scale * np.pi / 2 / np.cos(q * np.pi / 2) ** 2 * width * weights[:, None] / 2
    wi, area = half_to_incoming(slope.ravel(), np.broadcast_to(turn, q.shape).ravel(), wo)
    wi[:, 2] = np.maximum(wi[:, 2], 1e-12)
    pdf = brdf_runs.run(shaders, "evaluate", len(wi), material, wo, wi)[:, 2, 0]
    shares = (pdf * area).reshape(q.shape) * d_slope * (2 * np.pi / len(turn))
    shares = shares.sum(axis=1).reshape(CELLS[0], CELLS[1], FINE).sum(axis=2)
    # the horizon may cut a corner of a cell between two turns: little is expected there, but it isn't impossible
    reach = np.max([horizon, np.roll(horizon, 1), np.roll(horizon, -1)], axis=0).reshape(CELLS[1], FINE).max(axis=1)
    possible = np.arange(CELLS[0])[:, None] / CELLS[0] < reach + 1e-3
    return np.where(possible, np.maximum(shares, 1e-12), 0)


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
    half = wi[valid].astype(np.float64) + wo
    half /= half[:, 2:]
    q = np.arctan(np.hypot(half[:, 0], half[:, 1]) / scale) * 2 / np.pi
    turn = np.arctan2(half[:, 1], half[:, 0]) / (2 * np.pi) % 1
    observed, _, _ = np.histogram2d(q, turn, CELLS, [[0, 1], [0, 1]])
    expected = expected_shares(shaders, material, wo, scale) * COUNT
    lost = COUNT - valid.sum()
    assert expected.sum() <= COUNT * 1.0005
    observed, expected = np.append(observed, lost), np.append(expected, max(COUNT - expected.sum(), 0))
    if lost < 5 and expected[-1] < 1e-3 * COUNT:
        observed, expected = observed[:-1], expected[:-1]
    assert p_value(observed, expected) > level(len(CASES))


@pytest.mark.parametrize(("roughness", "metallic", "degrees"), CASES)
def test_draws_follow_the_density(shaders, roughness, metallic, degrees):
    check_density(shaders, roughness, metallic, degrees)


def random_directions(rng, count, edge_share=0.2):
    """Unit vectors of the upper hemisphere, some of them grazing, straight up or nearly either."""
    v = rng.normal(size=(count, 3))
    v[:, 2] = np.abs(v[:, 2])
    edges = rng.random(count) < edge_share
    v[edges, 2] = rng.choice([0, 1e-20, 1e-7, 1e-4, 1e3, 1e7, 1e30], edges.sum())
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    return v.astype(np.float32)


def random_materials(rng, count):
    edges = np.array([0, 1e-20, 1e-3, 0.03, 0.031622776, 0.0316228, 0.032, 0.5, 0.999999, 1], np.float32)
    records = np.zeros(count, brdf_runs.MATERIAL)
    for name in ("metallic", "perceptual_roughness"):
        records[name] = np.where(rng.random(count) < 0.5, rng.random(count), rng.choice(edges, count))
    for name in ("base_color", "reflectance"):
        records[name] = np.where(rng.random((count, 1)) < 0.5, rng.random((count, 3)), rng.choice(edges, (count, 1)))
    return records


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
