"""The path tracer against quadrature: a lamp over floors of our materials."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import brdf
from oracles.light import LAMP_CORNERS, LAMP_RADIANCE, floor_scene, lamp_above, on_lamp
from oracles.rays import over_pixels
from support.frames import path_traced_runs
from support.seeded_bugs import LOBES_ADDED, Bug, bug_tests, seeded
from support.statistics import assert_equal, compare

import solari_vk as sv

NODES = 16


def lamp_over_surface(surface, points, eye):
    """Radiance (N, 3) towards the eye from floor points under the lamp, by Gauss-Legendre quadrature."""
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    u, v = np.meshgrid((nodes + 1) / 2, (nodes + 1) / 2, indexing="ij")
    normal = np.cross(LAMP_CORNERS[1] - LAMP_CORNERS[0], LAMP_CORNERS[3] - LAMP_CORNERS[0])
    swap = [0, 2, 1]  # from the floor's frame, whose normal is y, to the oracle's, whose normal is z
    to_eye = eye - points
    to_eye /= np.linalg.norm(to_eye, axis=1, keepdims=True)
    to_lamp = on_lamp(u.ravel(), v.ravel())[None] - points[:, None]
    squared = (to_lamp**2).sum(axis=-1)
    to_lamp /= np.sqrt(squared)[..., None]
    received = to_lamp[..., 1] * np.abs(to_lamp @ normal) / squared * np.outer(weights, weights).ravel() / 4
    value = surface.value(np.broadcast_to(to_eye[:, None, swap], to_lamp.shape), to_lamp[..., swap])
    return np.einsum("nlc,nl->nc", value, received) * LAMP_RADIANCE


GLOSSY = (0.35, 0.0, 1.0)


@pytest.mark.parametrize(
    "case",
    [
        GLOSSY,
        *(
            pytest.param(case, marks=pytest.mark.slow)
            for case in (
                (*GLOSSY, "fresnel_product"),
                (0.6, 0.5, (0.2, 0.6, 1.0)),
                (*GLOSSY, "sum"),
                (0.35, 1.0, 0.5),
                (1.0, 0.0, 0.5),
            )
        ),
    ],
    ids=str,
)
def test_lamp_over_our_materials(device, case):
    """Compares a single bounce off a glossy floor with quadrature of the NumPy BRDF."""
    color, (roughness, metallic, reflectance, layering) = np.array((0.9, 0.5, 0.15)), (*case, "conserving")[:4]
    material = sv.Material(base_color=color, perceptual_roughness=roughness, metallic=metallic, reflectance=reflectance)
    scene = floor_scene(material, lamp_above())
    older = layering == "sum"  # as Solari 0.18
    with seeded(*[LOBES_ADDED] * older):
        options = {"max_bounces": 1, "layering": "fresnel_product" if older else layering}
        made = path_traced_runs(device, scene, (16, 16), 4096, **options)
    surface = brdf.Surface(color, metallic, roughness, reflectance, layering, resolution=96)
    eye = scene.camera.transform[:3, 3]
    expected = over_pixels(scene.camera, 16, lambda points: lamp_over_surface(surface, points, eye))
    assert_equal(compare(made.mean, made.variance, expected, tile=8), 0.01)


def check_glossy(device):
    test_lamp_over_our_materials(device, GLOSSY)


test_a_seeded_bug_is_noticed = bug_tests(
    {
        "weights of hits": (
            check_glossy,
            Bug(
                "scene/lights/emissive_mesh.glsl",
                "emissive_hit_pdf",
                "return 3.0 * correct(hit, ray_direction, ray_t);",
            ),
        ),
        "Fresnel": (check_glossy, Bug("scene/microfacet.glsl", "reflectance_f0", "return 0.5 * correct(reflectance);")),
        "half a pixel off": (
            check_glossy,
            Bug("scene/camera.glsl", "make_camera_ray", "return correct(pixel_position - 0.5);"),
        ),
    }
)
