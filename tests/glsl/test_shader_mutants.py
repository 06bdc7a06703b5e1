"""Seeded bugs in the shader library: the check that should notice each must fail."""

from __future__ import annotations

import pytest
import test_brdf_values as brdf_values
import test_distributions as distributions
import test_packing as packing
import test_random as random_numbers
import test_ray_offsets as ray_offsets
import test_surface as surface
from support.measured import hold

from solari_vk.conformance import brdf_checks

RANDOM, PACKING, SURFACE = "common/random.glsl", "common/packing.glsl", "scene/surface.glsl"
BRDF, PREPARED, TABLE = "scene/brdf.glsl", "scene/prepared_brdf.glsl", "scene/brdf_table.glsl"
MICROFACET = "scene/microfacet.glsl"


def furnace(shaders, metallic):
    hold(brdf_checks.measure_furnace(shaders, metallic))


def draws(shaders, *case):
    hold(brdf_checks.measure_draws(shaders, [case], 1_000_000))


def numbers(shaders):
    hold(brdf_checks.measure_numbers(shaders, 200_000))


GLOSSY = (0.5, 1.0, 60.0)
MUTANTS = {
    "generator: a wrong multiplier": (random_numbers.test_generators, (), RANDOM, "277803737u", "277803739u"),
    "generator: 23 bits": (random_numbers.test_generators, (), RANDOM, "(bits >> 8u) * ROUNDING_UNIT",
                           "(bits >> 9u) * (2.0 * ROUNDING_UNIT)"),
    "range: off by one": (random_numbers.test_generators, (), RANDOM, "rand_u(rng), n, high",
                          "rand_u(rng), n - 1u, high"),
    "disk: no square root": (distributions.test_disk, (), RANDOM, "return sqrt(u.x) * vec2", "return u.x * vec2"),
    "hemisphere: uniform for cosine": (distributions.test_hemispheres, (), RANDOM, "sqrt(1.0 - u.x));", "1.0 - u.x);"),
    "barycentrics: one corner preferred": (distributions.test_barycentrics, (), RANDOM, "float root = sqrt(u.x)",
                                           "float root = u.x"),
    "cone: twice as wide": (distributions.test_cone, (0.01, (0, 0, 1)), RANDOM, "one_minus_cos_half_angle * u.x",
                            "2.0 * one_minus_cos_half_angle * u.x"),
    "packing: truncation": (packing.test_packings, (), PACKING, "c * scale + 0.5", "c * scale"),
    "packing: full mantissa overflows": (packing.test_packings, (), PACKING, "== 512u", "== 513u"),
    "packing: octahedron folded wrongly": (packing.test_packings, (), PACKING, "abs(v.yx)", "abs(v.xy)"),
    "BRDF: dropped cosine": (furnace, (0.0,), BRDF, "(INVERSE_PI * wi.z);\n    if (brdf_lambert)",
                             "INVERSE_PI;\n    if (brdf_lambert)"),
    "BRDF: no multiple scattering": (furnace, (1.0,), PREPARED, "brdf.multiscatter = 1.0 / (ab.x + ab.y) - 1.0;", ""),
    "BRDF: diffuse not under the layer": (furnace, (0.0,), BRDF,
                                          "value *= 1.0 - dielectric_albedo(brdf, albedo_terms(brdf, wi));",
                                          ""),
    "table: off by one row": (furnace, (1.0,), TABLE, "first = cell.y * BRDF_TABLE_SIZE + cell.x;",
                              "first = (cell.y - min(cell.y, 1u)) * BRDF_TABLE_SIZE + cell.x;"),
    "BRDF: D by 1 - cos^2": (draws, (0.04, 1.0, 30.0), MICROFACET, "dot(half_vector.xy, half_vector.xy) + a2",
                             "(1.0 - square(half_vector.z)) + a2"),
    "sampling: pdf without Jacobian": (draws, GLOSSY, MICROFACET, "return 0.5 / (k", "return 1.0 / (k"),
    "sampling: pdf of unbounded VNDF": (draws, GLOSSY, MICROFACET, "(k * wo.z + sqrt", "(wo.z + sqrt"),
    "sampling: cap not bounded": (draws, GLOSSY, MICROFACET, "float b = k * wo_std.z", "float b = wo_std.z"),
    "sampling: lobes' chances swapped": (draws, (0.6, 0.0, 75.0), BRDF,
                                         "mix(INVERSE_PI * wi.z, specular_pdf(brdf, wo, wi),",
                                         "mix(specular_pdf(brdf, wo, wi), INVERSE_PI * wi.z,"),
    "sampling: weight without its pdf": (draws, GLOSSY, BRDF, "evaluate_brdf(brdf, wo, wi) / pdf :",
                                         "evaluate_brdf(brdf, wo, wi) :"),
    "BRDF: not reciprocal": (numbers, (), BRDF,
                             "value *= 1.0 - dielectric_albedo(brdf, albedo_terms(brdf, wi));", ""),
    "BRDF: grazing views divide by zero": (numbers, (), BRDF,
                                           "pdf > 0.0 ? evaluate_brdf(brdf, wo, wi) / pdf : vec3(0.0), pdf",
                                           "evaluate_brdf(brdf, wo, wi) / pdf, pdf"),
    "BRDF: shadowing of another roughness": (brdf_values.test_values, brdf_values.CASES[0], MICROFACET,
                                             "float a2 = square(roughness);\n    float shadowed_l",
                                             "float a2 = roughness;\n    float shadowed_l"),
    "BRDF: shadowing halved": (brdf_values.test_values, brdf_values.CASES[2], MICROFACET, "return 0.5 / max(",
                               "return 0.25 / max("),
    "normals: bent where they face away": (surface.test_bent_normals, (), SURFACE, "dot(normal, wo) > 0.0 && ", ""),
    "heuristic: not for infinity": (surface.test_heuristics, (), "common/math.glsl",
                                    "f == g ? 0.5 : 1.0 / (1.0 + g / f)", "f / (f + g)"),
    "normals: not bent": (surface.test_bent_normals, (), SURFACE,
                          "if (dot(normal, wo) > 0.0 && dot(mirrored, geometric_normal) >= min_cosine)", "if (true)"),
    "offset: an eighth of the bound": (ray_offsets.test_offsets, (1e-3,), SURFACE, "return 16.0 *", "return 2.0 *"),
    "offset: light's end not moved": (ray_offsets.test_offsets, (1.0,), "scene/light_visibility.glsl",
                                      "? -offset : offset)", "? offset : -offset)"),
}  # fmt: skip


@pytest.mark.parametrize("name", MUTANTS)
def test_seeded_bug_is_noticed(expect_failure, name):
    check, arguments, *patch = MUTANTS[name]
    expect_failure(tuple(patch), check, *arguments)


def test_without_a_bug_the_same_checks_hold(shaders):
    """The control of the mutants above, with the same efforts; the suite's group `brdf` runs all cases."""
    for metallic in (0.0, 1.0):
        furnace(shaders, metallic)
    for case in (GLOSSY, (0.04, 1.0, 30.0), (0.6, 0.0, 75.0)):
        draws(shaders, *case)
    numbers(shaders)
