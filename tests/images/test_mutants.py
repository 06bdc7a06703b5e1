"""Seeded bugs in copies of the path tracer's shaders: the test that should notice a bug must fail."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
import test_closed_forms as closed_forms
import test_estimators as estimators
import test_rays as rays

from solari_vk.gpu.shaders.patches import patched_shaders


@dataclass
class Mutant:
    """In `file`, `old` (found exactly once) becomes `new`; `proof(picture, tracer)` must then fail.

    Each costs a compilation of the path tracer, so only a few are quick.
    """

    file: str
    old: str
    new: str
    proof: object
    quick: bool = False


def glossy_lamp(picture, tracer):
    closed_forms.test_lamp_over_our_materials(picture, 0.35, 0.0, 1.0, "conserving")


def metal_lamp(picture, tracer):
    closed_forms.test_lamp_over_our_materials(picture, 0.35, 1.0, 0.5, "conserving")


def white_metal(picture, tracer):
    closed_forms.test_white_closed_box_with_our_brdf_keeps_all_energy(picture, 1.0, 1.0)


def box_series(picture, tracer):
    closed_forms.test_closed_box_series(picture, 5, "mis")


def white_box(picture, tracer):
    closed_forms.test_white_closed_box_with_our_brdf_keeps_all_energy(picture, 0.5, 0.0)


def wide_sun(picture, tracer):
    closed_forms.test_sun_over_lambert_floor(picture, 0.8, "mis")


def closed_surface(picture, tracer):
    rays.test_nothing_escapes_from_a_closed_surface(tracer, "far")


def baked_instances(picture, tracer):
    estimators.test_instances_equal_their_baked_meshes(picture, tracer)


def embree(picture, tracer):
    rays.test_camera_rays_hit_what_embree_hits(tracer, "cornell_box")


TRACE, AOV = "passes/pathtracer/trace.comp", "passes/pathtracer/aov.comp"
SAMPLING, MESH_LIGHT = "scene/sampling.glsl", "scene/lights/emissive_mesh.glsl"
BRDF, MICROFACET, SURFACE = "scene/brdf.glsl", "scene/microfacet.glsl", "scene/surface.glsl"
MUTANTS = {
    "weights in area measure": Mutant(
        MESH_LIGHT, "? square(ray_t) / inverse_pdf", "? 1.0 / inverse_pdf", glossy_lamp, quick=True
    ),
    "wrong light count": Mutant(
        SAMPLING, "float inverse_light_pdf = float(", "float inverse_light_pdf = 1.0 + float(", wide_sun, quick=True
    ),
    "roulette's survivors are not raised": Mutant(TRACE, "throughput /= survival;", "", box_series, quick=True),
    "emission counted twice": Mutant(
        TRACE, "surface.material.emissive * hit_weight(bounce_pdf, light_pdf)", "surface.material.emissive", glossy_lamp
    ),
    "no cosine at the light": Mutant(SAMPLING, "? cosine / distance_squared", "? 1.0 / distance_squared", glossy_lamp),
    "sun's pdf forgets the light count": Mutant(
        SAMPLING, "1.0 / (float(scene_info.light_count) * met.inverse_pdf)", "0.5 / met.inverse_pdf", wide_sun
    ),
    "no shadows": Mutant(TRACE, "trace_light_visibility(origin, light_sample)", "true", closed_surface),
    "no average under the layer": Mutant(BRDF, "*= through / (1.0 - average)", "*= through", white_box),
    "no multiple scattering": Mutant(
        BRDF, "brdf.multiscatter = 1.0 / (ab.x + ab.y) - 1.0", "brdf.multiscatter = 0.0", white_metal
    ),
    "visibility term halved": Mutant(
        MICROFACET, "return 0.5 / max(shadowed_l", "return 0.25 / max(shadowed_l", metal_lamp
    ),
    "pdf without its bound": Mutant(
        MICROFACET, "a2 * square(wo.z));\n    return 0.5", "a2 * square(wo.z)) + 1.0;\n    return 0.5", white_metal
    ),
    "no offset of ray origins": Mutant(
        SURFACE, "16.0 * ROUNDING_UNIT * dot(world_reach", "0.0 * dot(world_reach", closed_surface
    ),
    "mirrored instances turn inside out": Mutant(
        SURFACE, "cofactors *= dot(m[0], cofactors[0]) < 0.0 ? -1.0 : 1.0;", "", baked_instances
    ),
    "half a pixel off": Mutant(TRACE, "vec2(pixel) + 0.5 + sample", "vec2(pixel) + sample", glossy_lamp),
    "instances numbered from one": Mutant(AOV, "= hit.instance;", "= hit.instance + 1u;", embree),
}


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] if not m.quick else []) for n, m in MUTANTS.items()]
)
def test_a_seeded_bug_is_noticed(name, picture, tracer):
    mutant = MUTANTS[name]
    with patched_shaders((mutant.file, mutant.old, mutant.new)), pytest.raises(AssertionError):
        mutant.proof(picture, tracer)
