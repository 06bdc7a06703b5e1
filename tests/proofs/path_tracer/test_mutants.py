"""Seeded bugs in copies of the path tracer's shaders: the proof that should notice a bug must fail.

tests/conformance/test_light_bugs.py has more, which the suite's bars notice.
"""

from __future__ import annotations

import pytest
import test_closed_boxes as path_checks
import test_closed_forms as closed_forms
import test_estimators as estimators
import test_lamps_and_suns as light_checks
import test_rays as rays
from support.measured import hold
from support.patches import patched_shaders

PROOFS = {
    "glossy lamp": lambda device, picture, tracer: closed_forms.test_lamp_over_our_materials(
        picture, 0.35, 0.0, 1.0, "conserving"),
    "metal lamp": lambda device, picture, tracer: closed_forms.test_lamp_over_our_materials(
        picture, 0.35, 1.0, 0.5, "conserving"),
    "white metal": lambda device, picture, tracer: hold(path_checks.measure_white_box(device, 1.0, 1.0)),
    "white box": lambda device, picture, tracer: hold(path_checks.measure_white_box(device, 0.5, 0.0)),
    "wide sun": lambda device, picture, tracer: hold(light_checks.measure_sun(device, 0.8, "mis")),
    "closed surface": lambda device, picture, tracer: hold(path_checks.measure_light_tight(device, ["far"])),
    "baked instances": lambda device, picture, tracer: estimators.test_instances_equal_their_baked_meshes(
        picture, tracer),
    "Embree": lambda device, picture, tracer: rays.test_camera_rays_hit_what_embree_hits(tracer, "cornell_box"),
}  # fmt: skip
TRACE, AOV = "passes/pathtracer/trace.comp", "passes/pathtracer/aov.comp"
SAMPLING, MESH_LIGHT = "scene/sampling.glsl", "scene/lights/emissive_mesh.glsl"
BRDF, MICROFACET, SURFACE = "scene/prepared_brdf.glsl", "scene/microfacet.glsl", "scene/surface.glsl"
MUTANTS = {  # the proof that must fail, and the patch
    "weights in area measure": ("glossy lamp", MESH_LIGHT, "? square(ray_t) / cosine *", "? 1.0 / cosine *"),
    "emission counted twice": ("glossy lamp", TRACE, "surface.material.emissive * hit_weight(bounce_pdf, light_pdf)",
                               "surface.material.emissive"),
    "no cosine at the light": ("glossy lamp", SAMPLING, "? cosine / distance_squared", "? 1.0 / distance_squared"),
    "sun's pdf forgets its probability": ("wide sun", SAMPLING, "choice_probability / met.inverse_pdf",
                                          "0.5 / met.inverse_pdf"),
    "no shadows": ("closed surface", TRACE, "trace_light_transmittance(shadow_origin, light_sample)", "1.0"),
    "no average under the layer": ("white box", BRDF, "*= through / (1.0 - average)", "*= through"),
    "no multiple scattering": ("white metal", BRDF, "brdf.multiscatter = 1.0 / (ab.x + ab.y) - 1.0",
                               "brdf.multiscatter = 0.0"),
    "visibility term halved": ("metal lamp", MICROFACET, "return 0.5 / max(shadowed_l", "return 0.25 / max(shadowed_l"),
    "pdf without its bound": ("white metal", MICROFACET, "a2 * square(wo.z));\n    return 0.5",
                              "a2 * square(wo.z)) + 1.0;\n    return 0.5"),
    "mirrored instances turn inside out": ("baked instances", SURFACE,
                                           "cofactors *= dot(m[0], cofactors[0]) < 0.0 ? -1.0 : 1.0;", ""),
    "half a pixel off": ("glossy lamp", TRACE, "vec2(pixel) + 0.5 + sample", "vec2(pixel) + sample"),
    "instances numbered from one": ("Embree", AOV, "= hit.instance;", "= hit.instance + 1u;"),
}  # fmt: skip
QUICK = ("weights in area measure",)  # each costs a compilation of the path tracer


@pytest.mark.parametrize("name", [pytest.param(n, marks=() if n in QUICK else pytest.mark.slow) for n in MUTANTS])
def test_a_seeded_bug_is_noticed(name, device, picture, tracer):
    proof, *patch = MUTANTS[name]
    with patched_shaders(tuple(patch)), pytest.raises(AssertionError):
        PROOFS[proof](device, picture, tracer)
