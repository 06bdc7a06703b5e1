"""Glass against Mitsuba's dielectrics: pictures of a block in an environment that is brighter on one side."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import mitsuba_scene
from support.seeded_bugs import Bug, seeded
from support.statistics import assert_equal, compare

import solari_vk as sv
from solari_vk.scene import shapes

SIZE = (32, 32)
BOUNCES = 32
BAR = 0.012
FRESNEL = ("scene/microfacet.glsl", "dielectric_fresnel")
# Mitsuba counts the light that is reflected to and fro in a thin wall; KHR_materials_transmission doesn't.
MANY_REFLECTIONS = Bug(*FRESNEL, "float once = correct(eta, cosine); return 2.0 * once / (1.0 + once);")
# Mitsuba leaves out light that microfacets scatter more than once, and takes a microfacet's visibility from one side as
# independent of that from the other.
SINGLE_SCATTERING = Bug(
    "scene/lobes/glass.glsl",
    "prepare_glass",
    "Glass glass = correct(parameters, base, cosine); glass.compensation = vec3(1.0); return glass;",
)
INDEPENDENT_SHADOWS = Bug(
    "scene/lobes/glass.glsl",
    "evaluate_glass",
    "float o = smith_lambda(glass.roughness, wo), i = smith_lambda(glass.roughness, wi); "
    "return correct(glass, wo, wi) * ((1.0 + o + i) / ((1.0 + o) * (1.0 + i)));",
)
INDICES = {"int_ior": 1.5, "ext_ior": 1.0}
CASES = {  # our material, Mitsuba's, and what differs by design
    "solid": ({"solid": True}, {"type": "dielectric", **INDICES}, ()),
    "thin": ({}, {"type": "thindielectric", **INDICES}, (MANY_REFLECTIONS,)),
    "rough": (
        {"solid": True, "perceptual_roughness": 0.6},
        {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.36, **INDICES},
        (SINGLE_SCATTERING, INDEPENDENT_SHADOWS),
    ),
}


def radiance(polar, width):
    """Radiance (heights, width, 3) that is brightest on one side, in other places for each color."""
    longitude = 2 * np.pi * ((np.arange(width) + 0.5) / width - 0.5)
    around = np.stack([1 + 0.9 * np.sin(longitude + turn) for turn in (0.0, 1.0, 3.0)], axis=-1)
    return (around * (1 + np.cos(polar))[:, None, None] ** 2).astype(np.float32)


def check_block(picture, name, *bugs):
    """Compares our picture of one of CASES with Mitsuba's."""
    fields, theirs, by_design = CASES[name]
    glass = {"base_color": 1.0, "transmission": 1.0, "perceptual_roughness": 0.0, "double_sided": True, **fields}
    scene = sv.Scene(sv.Instance(shapes.box(), sv.Material(**glass)))
    scene.camera = sv.Camera.look_at((1.2, 0.8, 1.5), (0, 0, 0), vertical_fov=0.55)
    scene.environment = sv.Environment(radiance(np.pi * (np.arange(256) + 0.5) / 256, 512), rotation=0.7)
    mitsuba = mitsuba_scene.select_variant(vectorized=False)
    pixels = radiance(np.linspace(0, np.pi, 64), 128)  # Mitsuba's first and last rows are the poles
    emitters = {"map": mitsuba_scene.environment_of(mitsuba, scene.environment, pixels)}
    live = mitsuba_scene.scene_of(mitsuba, scene, *SIZE, bounces=BOUNCES, bsdf=theirs, emitters=emitters)
    mean, variance = mitsuba_scene.render(mitsuba, live, 8, 64)
    with seeded(*by_design, *bugs):
        made = picture(scene, SIZE, 1024, max_bounces=BOUNCES)
    assert_equal(compare(made.mean, made.variance, mean, variance), BAR, name)


@pytest.mark.parametrize(
    "name", ["solid", *(pytest.param(name, marks=pytest.mark.slow) for name in CASES if name != "solid")]
)
def test_a_block_is_mitsubas(picture, name):
    check_block(picture, name)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_too_few_reflections_are_noticed(picture, name):
    bug = Bug(*FRESNEL, "return correct(eta > 1.0 ? 1.45 : 1.0 / 1.45, cosine);")
    with pytest.raises(AssertionError):
        check_block(picture, name, bug)
