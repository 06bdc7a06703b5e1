"""Glass, clearcoat, sheen and anisotropy: energy, the distribution of samples, and reciprocity."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from support import brdf_runs
from support.measured import hold
from support.seeded_bugs import Bug, bug_tests, with_shaders
from support.statistics import chi_squared_p, sidak, standard_deviations

from solari_vk.conformance.rules import Measurement, Rule
from solari_vk.conformance.shader_runner import ShaderRunner

Floats = NDArray[Any]
_SOURCE = ("energy and probability", "scene/prepared_brdf.glsl")
_DEGREES = (0, 30, 60, 75, 84)
_GLASS = {"base_color": 1.0, "transmission": 1.0}
_SIDES: dict[str, dict[str, Any]] = {
    "a thin wall": {},
    "the outside of a solid": {"solid": 1},
    "the inside of a solid": {"solid": 1, "inside": 1},
}
_LAYERS: dict[str, dict[str, Any]] = {
    "a smooth coat": {"coat": 1.0, "roughness": 0.5},
    "a rough coat on metal": {"coat": 1.0, "coat_roughness": 0.4, "metallic": 1.0, "roughness": 0.4},
    "a tilted coat": {"coat": 1.0, "coat_roughness": 0.3, "coat_normal": (0.28, 0.0, 0.96), "roughness": 0.6},
    "sheen": {"sheen_color": 1.0, "sheen_roughness": 0.4, "roughness": 0.6},
    "smooth sheen": {"sheen_color": 1.0, "sheen_roughness": 0.1, "roughness": 0.6},
    "anisotropic metal": {"anisotropy": 0.6, "anisotropy_direction": (0.6, 0.8), "metallic": 1.0, "roughness": 0.4},
    "strongly anisotropic metal": {
        "anisotropy": 1.0, "anisotropy_direction": (0.6, 0.8), "metallic": 1.0, "roughness": 0.2,
    },
    "an anisotropic dielectric": {"anisotropy": 0.9, "anisotropy_direction": (0.6, 0.8), "roughness": 0.3},
    "a smooth anisotropic dielectric": {"anisotropy": 0.6, "anisotropy_direction": (0.6, 0.8), "roughness": 0.2},
    "weak reflections": {"specular_weight": 0.3, "roughness": 0.3},
    "all at once": {
        "coat": 0.6, "coat_roughness": 0.5, "sheen_color": 0.5, "sheen_roughness": 0.5, "anisotropy": 0.5,
        "metallic": 0.3, "transmission": 0.5, "solid": 1, "roughness": 0.5,
    },
}  # fmt: skip
_GAIN = 0.004  # of interpolation in tables
# What layers take twice, from light on its way down and up, is at most the layer's mean albedo: that of a coat is
# F0 + (1 - F0) / 21. Tilted coats also send grazing reflections below the surface. Where the albedo of an anisotropic
# dielectric is unknown, its bound loses light.
_COAT_LOSS = 0.04 + 0.96 / 21
_LOSSES = {
    "a tilted coat": 0.3, "sheen": 0.11, "anisotropic metal": 0.01, "strongly anisotropic metal": 0.01,
    "an anisotropic dielectric": 0.22, "a smooth anisotropic dielectric": 0.12,
}  # fmt: skip
_SMOOTH = ("a smooth coat", "smooth sheen", "a smooth anisotropic dielectric")  # whose lobes cells don't resolve
CELLS = (32, 32)  # over the cosine, of both sides, and the turn of a direction
FINE = 12  # points of a cell along each axis


def _albedo(shaders: ShaderRunner, turn: float = 0.4, **material: Any) -> Floats:
    wo = np.array([brdf_runs.direction(degrees, turn) for degrees in _DEGREES])
    records = brdf_runs.materials(**material)
    return brdf_runs.run(shaders, "sampled_albedo", len(wo), records, wo, **brdf_runs.ALL_LOBES)[:, 0]


def measure_glass_furnace(shaders: ShaderRunner) -> Iterator[Measurement]:
    """White glass neither gains nor loses light, at any roughness, from both sides, also when it reflects less than its
    index of refraction says."""
    for name, side in _SIDES.items():
        rule = Rule(f"white glass gains and loses no light: {name}", *_SOURCE)
        for roughness in (0.0, 0.15, 0.3, 0.5, 0.75, 1.0):
            for ior, weight in ((1.1, 1.0), (1.33, 1.0), (1.5, 1.0), (1.8, 1.0), (1.5, 0.4)):
                reflectance = weight * 2.5 * (ior - 1) / (ior + 1)  # 1: of this index of refraction
                albedo = _albedo(shaders, roughness=roughness, ior=ior, reflectance=reflectance, **_GLASS, **side)
                off = np.abs(albedo - 1).max()
                note = f"roughness {roughness:g}, ior {ior:g}, reflectance {reflectance:.2g}"
                yield Measurement(rule, float(off), 0.01, "lost or gained", note)


def measure_layer_furnace(shaders: ShaderRunner) -> Iterator[Measurement]:
    """Layers over a white surface gain no light and lose little."""
    for name, layers in _LAYERS.items():
        for turn in (0.3, 0.927, 2.5):
            albedo = _albedo(shaders, turn, **layers)
            yield Measurement(Rule(f"layers gain no light: {name}", *_SOURCE), float(albedo.max() - 1), _GAIN, "gained")
            rule = Rule(f"layers keep most light: {name}", *_SOURCE)
            yield Measurement(rule, float(1 - albedo.min()), _LOSSES.get(name, _COAT_LOSS), "lost")


def sphere_cells(wi: Floats) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The rows and columns of CELLS of directions (N, 3): equal steps of the cosine and of the turn."""
    row = np.clip(((wi[:, 2] + 1) / 2 * CELLS[0]).astype(np.intp), 0, CELLS[0] - 1)
    turn = np.arctan2(wi[:, 1], wi[:, 0]) / (2 * np.pi) % 1
    return row, np.minimum((turn * CELLS[1]).astype(np.intp), CELLS[1] - 1)


def expected_shares(shaders: ShaderRunner, material: NDArray[Any], wo: Floats) -> Floats:
    """The probability of each cell, from brdf_pdf: Gauss quadrature over the cosine, midpoints over the turn."""
    nodes, weights = np.polynomial.legendre.leggauss(FINE)
    cosine = (np.arange(CELLS[0])[:, None] + (nodes + 1) / 2) / CELLS[0] * 2 - 1
    turn = 2 * np.pi * (np.arange(CELLS[1] * FINE) + 0.5) / (CELLS[1] * FINE)
    z, phi = (grid.ravel() for grid in np.meshgrid(cosine.ravel(), turn, indexing="ij"))
    sine = np.sqrt(1 - z * z)
    wi = np.stack([sine * np.cos(phi), sine * np.sin(phi), z], axis=1)
    pdf = brdf_runs.run(shaders, "evaluate", len(wi), material, wo, wi, **brdf_runs.ALL_LOBES)[:, 2, 0]
    cells = pdf.astype(np.float64).reshape(CELLS[0], FINE, CELLS[1], FINE).sum(axis=3)
    shares: Floats = np.einsum("rnc,n->rc", cells, weights / CELLS[0]) * 2 * np.pi / (CELLS[1] * FINE)
    return shares


def measure_lobe_draws(shaders: ShaderRunner, count: int) -> Iterator[Measurement]:
    """Samples of rough lobes follow brdf_pdf, and their weights are f cos / pdf."""
    materials = {f"glass, {name}": {"roughness": 0.55, **_GLASS, **side} for name, side in _SIDES.items()}
    materials |= {name: layers for name, layers in _LAYERS.items() if name not in _SMOOTH}
    bar = standard_deviations(sidak(0.01, len(materials)))
    for name, fields in materials.items():
        record = brdf_runs.materials(**{"base_color": 0.8, **fields})
        wo = brdf_runs.direction(50)
        rows = brdf_runs.run(shaders, "draw", count, record, wo, **brdf_runs.ALL_LOBES).astype(np.float64)
        wi, weight, (pdf, drawn_pdf, _), value = rows[:, 0], rows[:, 1], rows[:, 2].T, rows[:, 3]
        valid = (drawn_pdf > 0) & (wi[:, 2] != 0)
        off = np.abs(weight[valid] * pdf[valid, None] - value[valid]) / np.maximum(value[valid], 1e-4)
        yield Measurement(Rule("the weight of a sample is f cos / pdf, all lobes", *_SOURCE), float(off.max()), 2e-3,
                          "relative error", name)  # fmt: skip
        shares = expected_shares(shaders, record, wo)
        counts = np.zeros(CELLS)
        np.add.at(counts, sphere_cells(wi[valid]), 1)
        observed = np.append(counts, count - valid.sum())
        expected = np.append(np.maximum(shares, 1e-12), max(1 - shares.sum(), 1e-12)) * count
        z = standard_deviations(chi_squared_p(observed, expected))
        yield Measurement(Rule(f"samples follow brdf_pdf: {name}", *_SOURCE), z, bar, "standard deviations")


def measure_lobe_reciprocity(shaders: ShaderRunner, count: int) -> Iterator[Measurement]:
    """Light takes each way back as it came; through glass, divided by the square of the index of refraction."""
    rng = np.random.default_rng(7)

    def directions() -> NDArray[np.float32]:
        v = rng.normal(size=(count, 3))
        v[:, 2] = np.abs(v[:, 2]) + 0.2
        return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True), np.float32)

    def values(wo: Floats, wi: Floats, **fields: Any) -> Floats:
        record = brdf_runs.materials(**fields)
        rows = brdf_runs.run(shaders, "evaluate", len(wo), record, wo, wi, **brdf_runs.ALL_LOBES)
        return (rows[:, 1] + rows[:, 3])[:, 0] / np.abs(wi[:, 2])

    flip = np.array((1, 1, -1), np.float32)
    # So smooth that multiple scattering, which isn't reciprocal, stays below the bar.
    solid = {"roughness": 0.15, "ior": 1.5, "solid": 1, **_GLASS}
    wo = directions()
    wi = brdf_runs.run(shaders, "draw", count, brdf_runs.materials(**solid), wo, **brdf_runs.ALL_LOBES)[:, 0]
    refracted = (wi[:, 2] < -0.2) & (wo[:, 2] > 0.5)
    wo, wi = wo[refracted], wi[refracted]
    there, back = values(wo, wi, **solid), values(wi * flip, wo * flip, **solid, inside=1)
    yield _reciprocal("refraction is reciprocal but for the square of its index", there, back * 1.5**2, 1e-2)
    wo, wi = directions(), directions()
    for name, fields in (
        ("sheen over a diffuse surface", {"sheen_color": 0.8, "sheen_roughness": 0.5, "reflectance": 0.0}),
        ("a coat over a diffuse surface", {"coat": 0.8, "coat_roughness": 1e-3, "reflectance": 0.0}),
        ("an anisotropic dielectric without multiple scattering",
         {"anisotropy": 0.7, "base_color": 0.0, "reflectance": 0.0, "roughness": 0.4}),
    ):  # fmt: skip
        yield _reciprocal(f"{name} is reciprocal", values(wo, wi, **fields), values(wi, wo, **fields), 1e-3)


def measure_lobes(shaders: ShaderRunner, count: int) -> Iterator[Measurement]:
    """All of the above. count: of samples."""
    yield from measure_glass_furnace(shaders)
    yield from measure_layer_furnace(shaders)
    yield from measure_lobe_draws(shaders, count)
    yield from measure_lobe_reciprocity(shaders, count // 10)


def _reciprocal(what: str, there: Floats, back: Floats, bar: float) -> Measurement:
    error = (np.abs(there - back) / (np.abs(back) + 1e-3 * np.abs(back).max())).max()
    return Measurement(Rule(what, *_SOURCE), float(error), bar, "relative error")


# ---- each rule holds, and can fail --------------------------------------------------------------------

def test_glass_furnace(shaders):
    hold(measure_glass_furnace(shaders))


def test_layer_furnace(shaders):
    hold(measure_layer_furnace(shaders))


@pytest.mark.slow
def test_draws(shaders):
    hold(measure_lobe_draws(shaders, 1_000_000))


def test_reciprocity(shaders):
    hold(measure_lobe_reciprocity(shaders, 100_000))


GLASS = "scene/lobes/glass.glsl"
GLASS_FURNACE, LAYER_FURNACE = with_shaders(measure_glass_furnace), with_shaders(measure_layer_furnace)
DRAWS = with_shaders(measure_lobe_draws, 200_000)
test_a_seeded_bug_is_noticed = bug_tests({
    "glass furnace": (GLASS_FURNACE, Bug(
        "scene/brdf_table.glsl", "lookup_glass_table", "return vec2(1.0, 0.0);")),
    "layers gain light": (LAYER_FURNACE, Bug("scene/lobes/coat.glsl", "coat_cover", "return 1.0;")),
    "layers lose light": (LAYER_FURNACE, Bug(
        "scene/lobes/sheen.glsl", "sheen_cover", "return 0.5 * correct(sheen, wo, wi);")),
    "density of glass": (DRAWS, Bug(GLASS, "glass_jacobian", "return 1.1 * correct(glass, wo, wi, m);")),
    "density of coats": (DRAWS, Bug("scene/lobes/coat.glsl", "coat_pdf", "return 1.1 * correct(coat, wi);")),
    "density of anisotropic lobes": (DRAWS, Bug(
        "scene/microfacet.glsl", "vndf_bound", "return 1.0;")),
    "reciprocity of glass": (with_shaders(measure_lobe_reciprocity, 100_000), Bug(
        GLASS, "evaluate_glass", "return correct(glass, wo, wi) * (1.0 + 0.1 * wo.z);")),
    "reciprocity of sheen": (with_shaders(measure_lobe_reciprocity, 100_000), Bug(
        "scene/lobes/sheen.glsl", "evaluate_sheen(float", "return correct(alpha, wo, wi) * (1.0 + 0.1 * wo.z);")),
}, quick=("layers gain light",))  # fmt: skip
