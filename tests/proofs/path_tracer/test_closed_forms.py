"""The path tracer against closed forms that the suite leaves out: a lamp over glossy floors, and the sun's disk."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support import brdf
from support.lamp_over_floor import LAMP_CORNERS, LAMP_RADIANCE, floor_scene, lamp_above
from support.older_solari import LOBES_ADDED
from support.oracles import closed_forms
from support.oracles.closed_forms import over_pixels
from support.seeded_bugs import Bug, seeded
from support.statistics import assert_equal, compare, replicates, tile_means

import solari_vk as sv


def lamp_over_surface(surface, points, eye):
    """Radiance (N, 3) towards the eye from floor points under the lamp, by Gauss-Legendre quadrature."""
    nodes, weights = np.polynomial.legendre.leggauss(24)
    nodes, weights = (nodes + 1) / 2, weights / 2
    u, v = np.meshgrid(nodes, nodes, indexing="ij")
    edge_u, edge_v = LAMP_CORNERS[1] - LAMP_CORNERS[0], LAMP_CORNERS[3] - LAMP_CORNERS[0]
    lamp = (LAMP_CORNERS[0] + u[..., None] * edge_u + v[..., None] * edge_v).reshape(-1, 3)
    normal = np.cross(edge_u, edge_v)
    area = np.linalg.norm(normal)
    weight = (weights[:, None] * weights).reshape(-1) * area
    swap = [0, 2, 1]  # from the floor's frame, whose normal is y, to the oracle's, whose normal is z
    to_eye = eye - points
    to_eye /= np.linalg.norm(to_eye, axis=1, keepdims=True)
    to_lamp = lamp[None] - points[:, None]
    squared = (to_lamp**2).sum(axis=-1)
    to_lamp /= np.sqrt(squared)[..., None]
    cosine_lamp = np.abs(to_lamp @ (normal / area))
    wo = np.broadcast_to(to_eye[:, None, swap], to_lamp.shape)
    value = surface.value(wo, to_lamp[..., swap])
    return np.einsum("nlc,nl->nc", value, to_lamp[..., 1] * cosine_lamp / squared * weight) * LAMP_RADIANCE


@pytest.mark.parametrize(
    ("roughness", "metallic", "reflectance", "layering"),
    [
        (0.35, 0.0, 1.0, "conserving"),
        (0.35, 0.0, 1.0, "sum"),
        (0.35, 0.0, 1.0, "fresnel_product"),
        (0.35, 1.0, 0.5, "conserving"),
        (0.6, 0.5, (0.2, 0.6, 1.0), "conserving"),
        (1.0, 0.0, 0.5, "conserving"),
    ],
)
def test_lamp_over_our_materials(picture, roughness, metallic, reflectance, layering):
    """Compares a single bounce off a glossy floor with quadrature of the NumPy BRDF."""
    color = np.array((0.9, 0.5, 0.15))
    material = sv.Material(base_color=color, perceptual_roughness=roughness, metallic=metallic, reflectance=reflectance)
    scene = floor_scene(material, lamp_above())
    older = layering == "sum"  # as Solari 0.18
    with seeded(*[LOBES_ADDED] * older):
        made = picture(scene, (16, 16), 4096, max_bounces=1, layering="fresnel_product" if older else layering)
    surface = brdf.Surface(color, metallic, roughness, reflectance, layering)
    eye = scene.camera.transform[:3, 3]
    expected = over_pixels(scene.camera, 16, lambda points: lamp_over_surface(surface, points, eye))
    assert_equal(compare(made.mean, made.variance, expected, tile=8), 0.01)


def test_sun_disk_is_seen_with_its_radiance_and_size(picture):
    sun = sv.DirectionalLight(direction=(0, 0, 1), illuminance=100, angular_diameter=0.5)
    scene = floor_scene(sv.Material(), sun)
    camera = sv.Camera.look_at((0, 1, 0), (0, 1, -1), vertical_fov=1.0)
    made = picture(scene, (64, 64), 64, camera=camera)
    radiance = closed_forms.sun_radiance(100, 0.5)
    # The disk's radius in the picture is tan(0.25) / tan(0.5) of half the picture's height. Only the upper half of the
    # disk is measured, because the floor may cover the lower half.
    share = math.pi * (math.tan(0.25) / math.tan(0.5)) ** 2 / 4
    assert made.mean[32, 32] == pytest.approx(radiance, rel=1e-5)
    upper = made.mean[:32, :, 0].mean() / radiance
    assert upper == pytest.approx(share, rel=0.01)


@pytest.mark.slow
def test_seeds_are_unbiased_and_independent(tracer):
    """The mean of 24 seeds is the closed form, and their global means vary as those of independent pixels would."""
    scene = floor_scene(sv.Material(base_color=1.0), lamp_above())
    runs = []
    for seed in range(24):
        renderer = tracer(scene, (32, 32), max_bounces=1, lambert=True, seed=seed)
        runs.append(renderer.render(scene.camera, samples=64)["radiance"][..., 0].astype(np.float64))
        renderer.close()
    runs = np.stack(runs)
    up = np.array([(0.0, 1.0, 0.0)])
    irradiance = over_pixels(
        scene.camera, 32, lambda points: closed_forms.polygon_irradiance(points, up, LAMP_CORNERS, 5.0)
    )
    tiles, expected = (tile_means(group[..., None], 8) for group in (runs, irradiance[None, ..., 0] / math.pi))
    assert replicates(tiles, expected[0], 0.005) == (0, True)
    independent = math.sqrt(runs.var(axis=0, ddof=1).sum()) / 32**2
    assert runs.mean(axis=(1, 2)).std(ddof=1) / independent == pytest.approx(1, abs=0.45)


@pytest.mark.slow
@pytest.mark.parametrize("bug", [
    Bug("scene/lights/emissive_mesh.glsl", "emissive_hit_pdf", "return 3.0 * correct(hit, ray_direction, ray_t);"),
    Bug("scene/microfacet.glsl", "reflectance_f0", "return 0.5 * correct(reflectance);"),
    Bug("scene/camera.glsl", "make_camera_ray", "return correct(pixel_position - 0.5);"),
], ids=["weights of hits", "Fresnel", "half a pixel off"])  # fmt: skip
def test_a_seeded_bug_is_noticed(picture, bug):
    with seeded(bug), pytest.raises(AssertionError):
        test_lamp_over_our_materials(picture, 0.35, 0.0, 1.0, "conserving")
