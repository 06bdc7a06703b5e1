"""The surface model: energy, the distribution and weights of samples, reciprocity, and finite values."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from support import brdf_runs
from support.measured import hold
from support.seeded_bugs import Bug, bug_tests, with_shaders
from support.statistics import chi_squared_p, sidak, standard_deviations

from solari_vk.conformance.rules import Measurement, Rule, count_wrong
from solari_vk.conformance.shader_runner import ShaderRunner

Floats = NDArray[np.floating[Any]]
_SOURCE = ("energy and probability", "scene/brdf.glsl")
_WEIGHT = Rule("the weight of a sample is f cos / pdf", *_SOURCE)
_SAMPLES = Rule("samples are unit vectors with the pdf of brdf_pdf, and mirrors reflect exactly", *_SOURCE)
_VALUES = Rule("values are finite, not negative, and 0 below the surface", *_SOURCE)
_NUMBERS = Rule("samples hold no NaN, and their weights are below 30", *_SOURCE)
_FURNACE_BAR = 0.005
ROUGHNESS = np.concatenate([np.linspace(0, 0.12, 41), np.linspace(0.125, 1, 36)]).astype(np.float32)
DEGREES = [0, 10, 25, 40, 55, 65, 72, 77, 80, 82, 84, 85]
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
CELLS = (24, 32)  # cells over slope and turn of the half vector
FINE = 12  # quadrature points of a cell along each axis


def furnace(shaders: ShaderRunner, metallic: float, **constants: Any) -> Floats:
    """The albedo (roughness, angle) of a white surface."""
    wo = np.tile([brdf_runs.direction(d) for d in DEGREES], (len(ROUGHNESS), 1))
    roughness = np.repeat(ROUGHNESS, len(DEGREES))
    albedo = brdf_runs.albedo(shaders, brdf_runs.materials(metallic=metallic, roughness=roughness), wo, **constants)
    assert np.isfinite(albedo).all()
    assert np.ptp(albedo, axis=1).max() < 1e-6
    return albedo[:, 0].reshape(len(ROUGHNESS), len(DEGREES))


def measure_furnace(shaders: ShaderRunner, metallic: float) -> Iterator[Measurement]:
    """A white surface reflects all light, at each roughness and angle."""
    worst = np.abs(furnace(shaders, metallic) - 1)
    where = np.unravel_index(worst.argmax(), worst.shape)
    note = f"roughness {ROUGHNESS[where[0]]:g}, {DEGREES[where[1]]} degrees"
    rule = Rule(f"a white surface reflects all light of a white furnace, metallic {metallic:g}", *_SOURCE)
    yield Measurement(rule, float(worst.max()), _FURNACE_BAR, "lost or gained", note)


def half_to_incoming(slope: Floats, turn: Floats, wo: Floats) -> tuple[Floats, Floats]:
    """Directions wi (N, 3) for half vectors, and the solid angle of wi per d(slope) d(turn).

    `slope` is the tangent of the half vector's angle to the normal, `turn` its azimuth."""
    cos_h = 1 / np.sqrt(1 + slope**2)
    half = np.stack([slope * np.cos(turn), slope * np.sin(turn), np.ones_like(slope)], axis=-1) * cos_h[..., None]
    along = half @ wo
    return 2 * along[..., None] * half - wo, 4 * np.abs(along) * cos_h**3 * slope


def expected_shares(shaders: ShaderRunner, material: NDArray[Any], wo: Floats, scale: float) -> Floats:
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
    pdf = brdf_runs.run(shaders, "evaluate", len(wi), material, wo, wi)[:, 2, 0]
    shares = (pdf * area).reshape(q.shape) * d_slope * (2 * np.pi / len(turn))
    shares = shares.sum(axis=1).reshape(CELLS[0], CELLS[1], FINE).sum(axis=2)
    # The horizon may cut the corner of a cell between two turns. Samples there are rare, but possible.
    reach = np.max([horizon, np.roll(horizon, 1), np.roll(horizon, -1)], axis=0).reshape(CELLS[1], FINE).max(axis=1)
    possible = np.arange(CELLS[0])[:, None] / CELLS[0] < reach + 1e-3
    return np.where(possible, np.maximum(shares, 1e-12), 0)


def drawn_cells(
    shaders: ShaderRunner, material: NDArray[Any], wo: Floats, wi: Floats, scale: float, count: int
) -> tuple[Floats, Floats]:
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


def measure_draws(
    shaders: ShaderRunner, cases: Sequence[tuple[float, float, float]], count: int
) -> Iterator[Measurement]:
    """Samples follow brdf_pdf, and their weights are f cos / pdf."""
    bar = standard_deviations(sidak(0.01, len(cases)))
    for roughness, metallic, degrees in cases:
        name = f"roughness {roughness:g}, metallic {metallic:g}, {degrees:g} degrees"
        material, wo = brdf_runs.materials(0.8, 0.5, metallic, roughness), brdf_runs.direction(degrees)
        rows = brdf_runs.run(shaders, "draw", count, material, wo)
        wi, weight, pdf, value = rows[:, 0], rows[:, 1], rows[:, 2, 0], rows[:, 3]
        valid = np.isfinite(rows[:, 2, 1]) & (wi[:, 2] > 0)
        off = np.abs(weight[valid] * pdf[valid, None] / np.maximum(value[valid], 1e-20) - 1).max()
        yield Measurement(_WEIGHT, float(off), 2e-3, "relative error", name)
        wrong = [f"{what}, {name}" for what in _wrong_draws(rows, valid, roughness, wo)]
        yield count_wrong(_SAMPLES, wrong)
        scale = max(roughness**2, 0.3 if metallic < 1 else 0.0)
        z = standard_deviations(chi_squared_p(*drawn_cells(shaders, material, wo, wi[valid], scale, count)))
        yield Measurement(Rule(f"samples follow brdf_pdf, {name}", *_SOURCE), z, bar, "standard deviations")


def _wrong_draws(rows: Floats, valid: NDArray[np.bool_], roughness: float, wo: Floats) -> Iterator[str]:
    """What is wrong with samples (N, 4, 3) of a dielectric mirror (roughness 0) or of any rough surface."""
    wi, weight, (pdf, drawn_pdf, probability) = rows[:, 0], rows[:, 1], rows[:, 2].T
    mirrored = np.isinf(drawn_pdf)
    if (np.abs(np.linalg.norm(wi[valid], axis=1) - 1) > 1e-5).any():
        yield "length"
    if (weight[~mirrored & ~valid] != 0).any():
        yield "weight below the surface"
    if not ((pdf[valid] > 0) & (np.abs(drawn_pdf[valid] - pdf[valid]) <= 1e-8 + 1e-3 * pdf[valid])).all():
        yield "pdf"
    if roughness > 0:
        if mirrored.any():
            yield "a mirror"
        return
    if np.abs(wi[mirrored] - wo * (-1, -1, 1)).max() >= 1e-6:
        yield "mirrored direction"
    if abs(mirrored.mean() - probability[0]) >= 5 * np.sqrt(probability[0] / len(rows)):
        yield "share of mirrored draws"
    if np.abs(weight[mirrored] * probability[0] / (0.04 + 0.96 * (1 - wo[2]) ** 5) - 1).max() >= 1e-5:
        yield "mirrored weight"


def random_directions(rng: np.random.Generator, count: int, edge_share: float = 0.2) -> NDArray[np.float32]:
    """Unit vectors of the upper hemisphere; some of them graze the surface or are close to the normal."""
    v = rng.normal(size=(count, 3))
    v[:, 2] = np.abs(v[:, 2])
    edges = rng.random(count) < edge_share
    v[edges, 2] = rng.choice([0, 1e-20, 1e-7, 1e-4, 1e3, 1e7, 1e30], edges.sum())
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    return v.astype(np.float32)


def random_materials(rng: np.random.Generator, count: int) -> NDArray[Any]:
    """Records of brdf_runs.MATERIAL, many of them at or near the limits of their fields."""
    edges = np.array([0, 1e-20, 1e-3, 0.03, 0.031622776, 0.0316228, 0.032, 0.5, 0.999999, 1], np.float32)
    records = np.resize(brdf_runs.materials(), count)
    for name in ("metallic", "perceptual_roughness"):
        records[name] = np.where(rng.random(count) < 0.5, rng.random(count), rng.choice(edges, count))
    for name in ("base_color", "reflectance"):
        records[name] = np.where(rng.random((count, 1)) < 0.5, rng.random((count, 3)), rng.choice(edges, (count, 1)))
    return records


def measure_numbers(shaders: ShaderRunner, count: int) -> Iterator[Measurement]:
    """Values and samples are finite, not negative and not below the surface; both lobes are reciprocal."""
    rng = np.random.default_rng(5)
    records = random_materials(rng, count)
    wo, wi = random_directions(rng, count), random_directions(rng, count)
    below = rng.random(count) < 0.1
    wi[below] *= -1
    rows = brdf_runs.run(shaders, "evaluate", count, records, wo, wi)
    bad = ~np.isfinite(rows).all(axis=(1, 2)) | (rows[:, 1:] < 0).any(axis=(1, 2))
    bad |= below & (rows[:, [1, 3]] != 0).any(axis=(1, 2))
    yield Measurement(_VALUES, float(bad.sum()), 0.0, f"of {count:,}")
    drawn = brdf_runs.run(shaders, "draw", count, records, wo)
    bad = np.isnan(drawn).any(axis=(1, 2)) | ~((drawn[:, 1] >= 0) & (drawn[:, 1] < 30)).all(axis=1)
    yield Measurement(_NUMBERS, float(bad.sum()), 0.0, f"of {count:,}")
    wo, wi = random_directions(rng, count, 0), random_directions(rng, count, 0)
    records["perceptual_roughness"] = rng.uniform(0.1, 1, count)
    for name, lobe in (("the diffuse lobe", 1), ("the specular lobe without multiple scattering", 3)):
        there = brdf_runs.run(shaders, "evaluate", count, records, wo, wi)[:, lobe] / wi[:, 2:]
        back = brdf_runs.run(shaders, "evaluate", count, records, wi, wo)[:, lobe] / wo[:, 2:]
        error = (np.abs(there - back) / (np.abs(back) + 1e-3)).max()
        yield Measurement(Rule(f"{name} is reciprocal", *_SOURCE), float(error), 1e-3 if lobe == 3 else 1e-4,
                          "relative error")  # fmt: skip
        records["metallic"], records["reflectance"] = 0, 0  # with F0 = 0 there is no multiple scattering


# ---- each rule holds, and can fail --------------------------------------------------------------------

@pytest.mark.parametrize("metallic", [0.0, 0.5, 1.0])
def test_white_furnace(shaders, metallic):
    hold(measure_furnace(shaders, metallic))


@pytest.mark.parametrize("case", [case if case in CASES[3:7] else pytest.param(case, marks=pytest.mark.slow)
                                  for case in CASES])  # fmt: skip
def test_draws(shaders, case):
    hold(measure_draws(shaders, [case], 1_000_000))


def test_numbers(shaders):
    hold(measure_numbers(shaders, 1_000_000))


BRDF, MICROFACET, SPECULAR = "scene/brdf.glsl", "scene/microfacet.glsl", "scene/lobes/specular.glsl"
GLOSSY = with_shaders(measure_draws, [(0.5, 1.0, 60.0)], 1_000_000)
NUMBERS = with_shaders(measure_numbers, 200_000)
test_a_seeded_bug_is_noticed = bug_tests({
    "furnace of dielectrics": (with_shaders(measure_furnace, 0.0), Bug(
        "scene/lobes/specular.glsl", "dielectric_albedo", "return vec3(0.0);")),
    "furnace of metals": (with_shaders(measure_furnace, 1.0), Bug(
        "scene/brdf_table.glsl", "lookup_brdf_table", "return 0.99 * correct(NdotV, perceptual_roughness);")),
    _WEIGHT: (GLOSSY, Bug(BRDF, "weigh_sample", "BrdfSample found = correct(brdf, wo, wi, diffuse); "
                          "found.weight *= 1.01; return found;")),
    _SAMPLES: (GLOSSY, Bug(SPECULAR, "sample_specular_lobe", "return 1.1 * correct(brdf, wo, u);")),
    "distribution": (GLOSSY, Bug(
        MICROFACET, "ggx_vndf_pdf_per_d(vec3 wo, float", "return 1.1 * correct(wo, roughness);")),
    "distribution of both lobes": (with_shaders(measure_draws, [(0.6, 0.0, 75.0)], 1_000_000), Bug(
        BRDF, "brdf_pdf", "return 0.5 * (correct(brdf, wo, wi) + specular_pdf(brdf, wo, wi));")),
    _VALUES: (NUMBERS, Bug(SPECULAR, "specular_distribution", "return correct(brdf, half_vector) - 1e-3;")),
    _NUMBERS: (NUMBERS, Bug(BRDF, "weigh_sample", "BrdfSample found = correct(brdf, wo, wi, diffuse); "
                            "found.weight /= found.pdf == 0.0 ? 0.0 : 1.0; return found;")),
    "reciprocity": (NUMBERS, Bug(
        BRDF, "evaluate_diffuse_brdf", "return correct(brdf, wo, wi) * (1.0 + 0.1 * wo.z);")),
}, quick=(_WEIGHT,))  # fmt: skip
