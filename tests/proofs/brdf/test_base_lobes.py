"""The surface model: energy, the distribution and weights of samples, reciprocity, finite values, and single values
against a NumPy reference that was written independently."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from oracles.brdf import Surface, alpha_of, directional_albedo_terms
from support.frames import direction_at, material_records, run_albedo, run_brdf
from support.seeded_bugs import LOBES_ADDED, Bug, bug_tests, seeded, with_shaders
from support.statistics import chi_squared_p

from solari_vk.lab.shader_runner import ShaderRunner

ROUGHNESS = np.concatenate([np.linspace(0, 0.12, 41), np.linspace(0.125, 1, 36)]).astype(np.float32)
DEGREES = [0, 10, 25, 40, 55, 65, 72, 77, 80, 82, 84, 85]
CASES = {  # perceptual roughness, metallic, degrees
    "smooth metal": (0.04, 1.0, 30.0),
    "smooth metal at a grazing angle": (0.1, 1.0, 80.0),
    "metal": (0.5, 1.0, 60.0),
    "rough metal at a grazing angle": (1.0, 1.0, 85.0),
    "plastic": (0.2, 0.0, 40.0),
    "rough plastic": (0.6, 0.0, 75.0),
    "both": (0.5, 0.5, 20.0),
    "a dielectric mirror": (0.0, 0.0, 50.0),
}
QUICK = ("metal", "rough plastic", "a dielectric mirror")
CELLS = (24, 32)  # cells over slope and turn of the half vector
FINE = 12  # quadrature points of a cell along each axis


# ---- energy -----------------------------------------------------------------------------------------


def furnace(shaders, metallic, **constants):
    """The albedo (roughness, angle) of a white surface."""
    wo = np.tile([direction_at(d) for d in DEGREES], (len(ROUGHNESS), 1))
    roughness = np.repeat(ROUGHNESS, len(DEGREES))
    albedo = run_albedo(shaders, material_records(metallic=metallic, roughness=roughness), wo, **constants)
    assert np.isfinite(albedo).all()
    assert np.ptp(albedo, axis=1).max() < 1e-6
    return albedo[:, 0].reshape(len(ROUGHNESS), len(DEGREES))


@pytest.mark.parametrize("metallic", [0.0, 0.5, 1.0])
def test_white_furnace(shaders, metallic):
    """A white surface reflects all light of a white furnace, at each roughness and angle."""
    off = np.abs(furnace(shaders, metallic) - 1)
    where = np.unravel_index(off.argmax(), off.shape)
    print(f"{off.max()} at roughness {ROUGHNESS[where[0]]:g}, {DEGREES[where[1]]} degrees")
    assert off.max() < 0.005


def test_solaris_layerings_have_the_known_errors(device, shaders):
    """Solari 0.18 adds both lobes, which gains energy; 0.19 multiplies Fresnel terms, which loses energy."""
    with seeded(LOBES_ADDED), ShaderRunner(device, Path(__file__).parent / "glsl") as adding:
        assert 1.4 < furnace(adding, 0.0, brdf_layering=1).max() < 1.7
    assert 0.3 < furnace(shaders, 0.0, brdf_layering=1).min() < 0.5


def test_lambert_switch(shaders):
    assert np.abs(furnace(shaders, 0.5, lambertian_surfaces=True) - 1).max() < 1e-5


# ---- samples ----------------------------------------------------------------------------------------


def half_to_incoming(slope, turn, wo):
    """Directions wi (N, 3) for half vectors, and the solid angle of wi per d(slope) d(turn).

    `slope` is the tangent of the half vector's angle to the normal, `turn` its azimuth."""
    cos_h = 1 / np.sqrt(1 + slope**2)
    half = np.stack([slope * np.cos(turn), slope * np.sin(turn), np.ones_like(slope)], axis=-1) * cos_h[..., None]
    along = half @ wo
    return 2 * along[..., None] * half - wo, 4 * np.abs(along) * cos_h**3 * slope


def expected_shares(shaders, material, wo, scale):
    """The probability of each cell (CELLS), integrated from brdf_pdf.

    Gauss quadrature over the slope, up to where wi meets the horizon, and midpoints over the turn."""
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
    pdf = run_brdf(shaders, "evaluate", len(wi), material, wo, wi)[:, 2, 0]
    shares = (pdf * area).reshape(q.shape) * d_slope * (2 * np.pi / len(turn))
    shares = shares.sum(axis=1).reshape(CELLS[0], CELLS[1], FINE).sum(axis=2)
    # The horizon may cut the corner of a cell between two turns. Samples there are rare, but possible.
    reach = np.max([horizon, np.roll(horizon, 1), np.roll(horizon, -1)], axis=0).reshape(CELLS[1], FINE).max(axis=1)
    possible = np.arange(CELLS[0])[:, None] / CELLS[0] < reach + 1e-3
    return np.where(possible, np.maximum(shares, 1e-12), 0)


def drawn_cells(shaders, material, wo, wi, scale, count):
    """How many of `count` samples fell into each cell, and how many are expected. wi (N, 3) are the valid samples.

    The last cell holds the samples below the horizon, if there are any."""
    half = wi.astype(np.float64) + wo
    half /= half[:, 2:]
    q = np.arctan(np.hypot(half[:, 0], half[:, 1]) / scale) * 2 / np.pi
    turn = np.arctan2(half[:, 1], half[:, 0]) / (2 * np.pi) % 1
    cells, _, _ = np.histogram2d(q, turn, CELLS, [[0, 1], [0, 1]])
    shares = expected_shares(shaders, material, wo, scale) * count
    lost = count - len(wi)
    observed, expected = np.append(cells, lost), np.append(shares, max(count - shares.sum(), 0))
    if lost < 5 and expected[-1] < 1e-3 * count:
        observed, expected = observed[:-1], expected[:-1]
    return observed, expected


@pytest.mark.parametrize(
    "case", [case if case in QUICK else pytest.param(case, marks=pytest.mark.slow) for case in CASES]
)
def test_draws(shaders, case):
    """Samples are unit vectors above the surface that follow brdf_pdf, their weights are f cos / pdf, and mirrors
    reflect exactly."""
    (roughness, metallic, degrees), count = CASES[case], 1_000_000
    material, wo = material_records(0.8, 0.5, metallic, roughness), direction_at(degrees)
    rows = run_brdf(shaders, "draw", count, material, wo)
    wi = rows[:, 0]
    weight = rows[:, 1]
    pdf, drawn_pdf, probability = rows[:, 2].T
    value = rows[:, 3]
    mirrored = np.isinf(drawn_pdf)
    valid = ~mirrored & (wi[:, 2] > 0)
    np.testing.assert_allclose(weight[valid] * pdf[valid, None] / np.maximum(value[valid], 1e-20), 1, rtol=2e-3)
    np.testing.assert_allclose(np.linalg.norm(wi[valid], axis=1), 1, atol=1e-5)
    assert not weight[~mirrored & ~valid].any(), "weight below the surface"
    assert (pdf[valid] > 0).all()
    np.testing.assert_allclose(drawn_pdf[valid], pdf[valid], rtol=1e-3, atol=1e-8)
    if roughness == 0:
        fresnel = 0.04 + 0.96 * (1 - wo[2]) ** 5
        np.testing.assert_allclose(wi[mirrored], np.tile(wo * (-1, -1, 1), (mirrored.sum(), 1)), atol=1e-6)
        assert abs(mirrored.mean() - probability[0]) < 5 * np.sqrt(probability[0] / count)
        np.testing.assert_allclose(weight[mirrored] * probability[0] / fresnel, 1, rtol=1e-5)
    else:
        assert not mirrored.any()
    scale = max(roughness**2, 0.3 if metallic < 1 else 0.0)
    assert chi_squared_p(*drawn_cells(shaders, material, wo, wi[valid], scale, count)) > 0.01


# ---- any directions and materials -------------------------------------------------------------------


def random_directions(rng, count, edge_share=0.2):
    """Unit vectors of the upper hemisphere; some of them graze the surface or are close to the normal."""
    v = rng.normal(size=(count, 3))
    v[:, 2] = np.abs(v[:, 2])
    edges = rng.random(count) < edge_share
    v[edges, 2] = rng.choice([0, 1e-20, 1e-7, 1e-4, 1e3, 1e7, 1e30], edges.sum())
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    return v.astype(np.float32)


def random_materials(rng, count):
    """Records of brdf_runs.MATERIAL, many of them at or near the limits of their fields."""
    edges = np.array([0, 1e-20, 1e-3, 0.03, 0.031622776, 0.0316228, 0.032, 0.5, 0.999999, 1], np.float32)
    records = np.resize(material_records(), count)
    for name in ("metallic", "perceptual_roughness"):
        records[name] = np.where(rng.random(count) < 0.5, rng.random(count), rng.choice(edges, count))
    for name in ("base_color", "reflectance"):
        records[name] = np.where(rng.random((count, 1)) < 0.5, rng.random((count, 3)), rng.choice(edges, (count, 1)))
    return records


@pytest.mark.parametrize("count", [50_000, pytest.param(500_000, marks=pytest.mark.slow)])
def test_numbers(shaders, count):
    """Values are finite, not negative and 0 below the surface; weights of samples are below 30."""
    rng = np.random.default_rng(5)
    records = random_materials(rng, count)
    wo, wi = random_directions(rng, count), random_directions(rng, count)
    below = rng.random(count) < 0.1
    wi[below] *= -1
    rows = run_brdf(shaders, "evaluate", count, records, wo, wi)
    assert np.isfinite(rows).all()
    assert (rows[:, 1:] >= 0).all()
    assert not rows[below][:, [1, 3]].any()
    drawn = run_brdf(shaders, "draw", count, records, wo)
    assert not np.isnan(drawn).any()
    assert ((drawn[:, 1] >= 0) & (drawn[:, 1] < 30)).all()


@pytest.mark.parametrize("layering", [0, 1])
def test_small_cosines_reflect(shaders, layering):
    """Differs from Solari 0.19, whose diffuse lobe is 0 where a cosine is below 1e-4."""
    z = np.array([1e-6, 9e-5, 2e-4])
    grazing = np.stack([np.sqrt(1 - z**2), 0 * z, z], axis=-1)
    for wo, wi in ((np.tile((0.0, 0.0, 1.0), (3, 1)), grazing), (grazing, np.tile((0.0, 0.0, 1.0), (3, 1)))):
        rows = run_brdf(shaders, "evaluate", 3, material_records(0.5, 0.5, 0.0, 0.6), wo, wi, brdf_layering=layering)
        assert (np.diff(rows[:, 1], axis=0, prepend=0) >= 0).all()
        assert (rows[:, 1] > 0).all()


def test_reciprocity(shaders):
    """Of the diffuse lobe, and of the specular one with F0 = 0, where there is no multiple scattering."""
    rng, count = np.random.default_rng(5), 50_000
    records = random_materials(rng, count)
    wo, wi = random_directions(rng, count, 0), random_directions(rng, count, 0)
    records["perceptual_roughness"] = rng.uniform(0.1, 1, count)
    for lobe, bar in ((1, 1e-4), (3, 1e-3)):
        there = run_brdf(shaders, "evaluate", count, records, wo, wi)[:, lobe] / wi[:, 2:]
        back = run_brdf(shaders, "evaluate", count, records, wi, wo)[:, lobe] / wo[:, 2:]
        assert (np.abs(there - back) / (np.abs(back) + 1e-3)).max() < bar
        records["metallic"], records["reflectance"] = 0, 0


# ---- single values ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("base_color", "metallic", "roughness", "reflectance", "bar"),
    [
        (0.6, 1.0, 0.2, 0.5, 2e-3),
        (0.5, 0.5, 0.6, 0.7, 2e-3),
        (0.8, 0.0, 0.1, 1.0, 1e-2),  # by the table's interpolation
    ],
)
def test_values(shaders, base_color, metallic, roughness, reflectance, bar):
    rng, count = np.random.default_rng(1), 400
    wo, wi = random_directions(rng, count), random_directions(rng, count)
    # half of them near the mirror direction, where a smooth surface shines
    wi[::2] = wo[::2] * (-1, -1, 1) + 0.1 * rng.normal(size=(count // 2, 3))
    wi /= np.linalg.norm(wi, axis=1, keepdims=True)
    inside = (wo[:, 2] > 0.05) & (wi[:, 2] > 0.05)
    wo, wi = wo[inside], wi[inside]
    material = material_records(base_color, reflectance, metallic, roughness)
    rows = run_brdf(shaders, "evaluate", len(wo), material, wo, wi)
    surface = Surface(base_color, metallic, roughness, reflectance, resolution=96)
    expected = surface.value(wo.astype(float), wi.astype(float)) * wi[:, 2:]
    np.testing.assert_allclose(rows[:, 1] + rows[:, 3], expected, rtol=bar)


def test_table_holds_the_albedo(shaders):
    """Nodes of the table against brute force; the cosine is the square of the column's relative position."""
    table = shaders.brdf_tables()["brdf_table"].read()
    for row, column in ((8, 12), (8, 63), (30, 30), (63, 12), (63, 63)):
        terms = directional_albedo_terms(alpha_of(row / 63), (column / 63) ** 2)
        np.testing.assert_allclose(table[row, column], terms, atol=1e-3)


# ---- each check can fail ----------------------------------------------------------------------------

BRDF = "scene/brdf.glsl"
MICROFACET = "scene/microfacet.glsl"
SPECULAR = "scene/lobes/specular.glsl"
METAL, NUMBERS = with_shaders(test_draws, "metal"), with_shaders(test_numbers, 50_000)
test_a_seeded_bug_is_noticed = bug_tests(
    {
        "furnace of dielectrics": (
            with_shaders(test_white_furnace, 0.0),
            Bug(SPECULAR, "dielectric_albedo", "return vec3(0.0);"),
        ),
        "furnace of metals": (
            with_shaders(test_white_furnace, 1.0),
            Bug("scene/brdf_table.glsl", "lookup_brdf_table", "return 0.99 * correct(NdotV, perceptual_roughness);"),
        ),
        "weights": (
            METAL,
            Bug(
                BRDF,
                "weigh_sample",
                "BrdfSample found = correct(brdf, wo, wi, diffuse); found.weight *= 1.01; return found;",
            ),
        ),
        "unit vectors": (METAL, Bug(SPECULAR, "sample_specular", "return 1.1 * correct(specular, wo, u);")),
        "distribution": (
            METAL,
            Bug(MICROFACET, "ggx_vndf_pdf_per_d(vec3 wo, float", "return 1.1 * correct(wo, roughness);"),
        ),
        "distribution of both lobes": (
            with_shaders(test_draws, "rough plastic"),
            Bug(BRDF, "brdf_pdf", "return 0.5 * (correct(brdf, wo, wi) + specular_pdf(brdf.specular, wo, wi));"),
        ),
        "values": (NUMBERS, Bug(SPECULAR, "specular_distribution", "return correct(specular, half_vector) - 1e-3;")),
        "finite samples": (
            NUMBERS,
            Bug(
                BRDF,
                "weigh_sample",
                "BrdfSample found = correct(brdf, wo, wi, diffuse); "
                "found.weight /= found.pdf == 0.0 ? 0.0 : 1.0; return found;",
            ),
        ),
        "reciprocity": (
            with_shaders(test_reciprocity),
            Bug(BRDF, "evaluate_diffuse_brdf", "return correct(brdf, wo, wi) * (1.0 + 0.1 * wo.z);"),
        ),
    },
    quick=("weights",),
)
