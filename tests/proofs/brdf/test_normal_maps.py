"""Layers over a base with a normal map, and under a normal map of their own: every estimator has the same mean."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from support.frames import PATHS, PLAIN_PATHS, make_renderer
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.scene import shapes

BLACK = {"base_color": 0.0, "specular": 0.0, "roughness": 0.5, "clearcoat": 1.0}
ROUGH_COAT = {"clearcoat": 1.0, "clearcoat_roughness": 0.4, "roughness": 0.5}
BELOW = {
    "an opaque base": {},
    "glass and leaf": {"transmission": 0.5, "diffuse_transmission": 1.0, "diffuse_transmission_color": 0.0},
}
LAYERS = {
    "a coat over glass": {**ROUGH_COAT, "transmission": 0.8},
    "a coat over a leaf": {**ROUGH_COAT, "diffuse_transmission": 0.6},
    "sheen": {"base_color": 0.1, "sheen_color": 1.0, "sheen_roughness": 0.5, "roughness": 0.5},
    "a film": {"metallic": 1.0, "roughness": 0.5, "iridescence": 1.0, "iridescence_thickness": (300, 300)},
    "glass": {"base_color": 1.0, "transmission": 1.0, "roughness": 0.4},
    "a leaf": {"diffuse_transmission": 0.6, "roughness": 0.6},
    "brushed metal": {"metallic": 1.0, "roughness": 0.5, "anisotropy": 0.6},
}
SIZE = (16, 16)


def tilted(degrees):
    """A normal map (4, 4, 3) that leans towards +x."""
    angle = np.radians(degrees)
    normal = np.array([np.sin(angle), 0, np.cos(angle)])
    return np.tile(np.round((normal * 0.5 + 0.5) * 255).astype(np.uint8), (4, 4, 1))


def surface(fields, view, tilt=0.0, name="normal_texture"):
    """A floor under a white sky, seen at `view` degrees from its normal, with this normal map."""
    scene = sv.Scene()
    scene.environment = sv.Environment((1.0, 1.0, 1.0))
    maps = {name: tilted(tilt)} if tilt else {}
    material = sv.Material(**{"base_color": 0.7, **fields, **maps}, double_sided=True)
    scene.add(shapes.quad((0, 0, 0), (50, 0, 0), (0, 0, -50)), material)
    eye = (-10 * np.sin(np.radians(view)), 10 * np.cos(np.radians(view)), 0)
    scene.camera = sv.Camera.look_at(eye, (0, 0, 0), orthographic_height=1.0)
    return scene


def traced(device, scene, samples=256, **options):
    with sv.PathTracer(device, scene, SIZE, **options) as tracer:
        return float(np.mean(tracer.render(scene.camera, samples=samples)["raw_radiance"]))


def framed(device, scene, **settings):
    with make_renderer(device, scene, SIZE, passes=PATHS, **{**PLAIN_PATHS, **settings}) as renderer:
        return float(np.mean([np.mean(renderer.render()["raw_radiance"]) for _ in range(32)]))


def check_coats(device, ways):
    """A coat over a black base has the surface's normal, and reflects the same share of the sky however the base's
    normals lean: KHR_materials_clearcoat."""
    for (below, fields), roughness in itertools.product(BELOW.items(), (0.0, 0.4)):
        coated = {**BLACK, **fields, "clearcoat_roughness": roughness}
        flat = traced(device, surface(coated, 82))
        for way in ways:
            found = way(device, surface(coated, 82, -30)) / flat
            assert abs(found - 1) < 0.02, f"{below}, roughness {roughness}: {way.__name__} {found:.3f}"


def check_estimators(device, names=tuple(LAYERS)):
    """Light samples, BRDF samples and both have one mean, and so have frames before the denoiser."""
    for name, view in itertools.product(names, (40, 75)):
        for texture in ("normal_texture", "clearcoat_normal_texture")[: 2 if "coat" in name else 1]:
            scene = surface(LAYERS[name], view, -30, texture)
            expected = traced(device, scene)
            for found in (
                traced(device, scene, light_strategy="brdf"),
                traced(device, scene, 1024, light_strategy="nee"),
                framed(device, scene),
            ):
                assert abs(found / expected - 1) < 0.02, f"{name}, {view} degrees, {texture}: {found / expected:.3f}"


def test_coats_are_as_over_a_flat_base(device):
    check_coats(device, (traced, framed))


@pytest.mark.slow
def test_estimators_agree(device):
    check_estimators(device)


COAT = "scene/lobes/coat.glsl"
test_a_seeded_bug_is_noticed = bug_tests(
    {
        "a coat in the base's frame": (
            lambda device: check_coats(device, (traced,)),
            Bug(COAT, "is_above_surface", "return wi.z > 0.0;"),
        ),
        "coat of a pixel": (
            lambda device: check_coats(device, (framed,)),
            Bug(
                "scene/material.glsl",
                "unpack_lobes",
                "ResolvedMaterial tilted = correct(material, packed, world_normal, geometric_world_normal);"
                " tilted.coat.surface_normal = NO_COAT.surface_normal; return tilted;",
            ),
        ),
    },
    quick=("a coat in the base's frame",),
)
