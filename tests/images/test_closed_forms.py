"""The path tracer against closed-form solutions: closed boxes, a lamp over a floor, the sun."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support import brdf

import solari_vk as sv
from solari_vk.conformance.light_checks import LAMP_CORNERS, LAMP_RADIANCE, floor_scene, lamp_above, lamp_on_lambert
from solari_vk.conformance.oracles import closed_forms
from solari_vk.conformance.oracles.closed_forms import over_pixels
from solari_vk.measure.statistics import compare, replicates, tile_means
from solari_vk.scene.builtin import closed_box

BAR = 0.005


def expect(picture, expected, what="", bar=BAR):
    """Require that the mean is within the bar with 95 % confidence, and that no 8x8 tile differs significantly."""
    expected = np.broadcast_to(expected, picture.mean.shape)
    result = compare(picture.mean, picture.variance, expected, np.zeros_like(expected), tile=8)
    print(what, result)
    result.assert_equal(bar, what)


@pytest.mark.parametrize("strategy", ["mis", "nee", "brdf"])
@pytest.mark.parametrize("bounces", [0, 1, 2, 5])
def test_closed_box_series(picture, bounces, strategy):
    scene = closed_box()
    albedo, emission = np.array((0.3, 0.5, 0.7)), np.array((2.0, 1.0, 0.25))
    next(iter(scene)).material.update(base_color=albedo, emissive=emission)
    made = picture(scene, (32, 32), 256, max_bounces=bounces, lambert=True, light_strategy=strategy)
    expected = closed_forms.closed_box_radiance(emission, albedo, bounces)
    error = np.abs(made.mean.mean(axis=(0, 1)) / expected - 1)
    print(bounces, strategy, error)
    assert (error < BAR).all(), error
    if bounces == 0:
        np.testing.assert_allclose(made.mean, np.broadcast_to(expected, made.mean.shape), rtol=1e-6)


@pytest.mark.parametrize("roughness", [0.0, 0.15, 0.5, 1.0])
@pytest.mark.parametrize("metallic", [0.0, 0.5, 1.0])
def test_white_closed_box_with_our_brdf_keeps_all_energy(picture, roughness, metallic):
    """Albedo 1 at every angle: each bounce adds the emission once more, whatever the material."""
    scene = closed_box(1.0, 1.0)
    next(iter(scene)).material.update(perceptual_roughness=roughness, metallic=metallic, reflectance=0.5)
    made = picture(scene, (32, 32), 128, max_bounces=3, light_strategy="mis")
    print(roughness, metallic, made.mean.mean() / 4 - 1)
    assert made.mean.mean() == pytest.approx(4.0, rel=BAR)


@pytest.mark.parametrize("strategy", ["mis", "nee", "brdf"])
def test_lamp_over_lambert_floor(picture, strategy):
    albedo = np.array((0.8, 0.5, 0.2))
    scene = floor_scene(sv.Material(base_color=albedo), lamp_above())
    samples = 4096 if strategy == "brdf" else 256
    made = picture(scene, (32, 32), samples, max_bounces=1, lambert=True, light_strategy=strategy)
    expect(made, lamp_on_lambert(scene, 32, albedo), strategy, 0.01 if strategy == "brdf" else BAR)


def lamp_over_surface(surface, points, eye, resolution=24):
    """Radiance (N, 3) towards the eye from floor points under the lamp, by Gauss-Legendre quadrature."""
    nodes, weights = np.polynomial.legendre.leggauss(resolution)
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
    made = picture(scene, (16, 16), 2048, max_bounces=1, layering=layering)
    surface = brdf.Surface(color, metallic, roughness, reflectance, layering)
    eye = scene.camera.transform[:3, 3]
    expected = over_pixels(scene.camera, 16, lambda points: lamp_over_surface(surface, points, eye))
    expect(made, expected, f"{roughness} {metallic} {layering}", bar=0.01)


@pytest.mark.parametrize(
    ("diameter", "strategy"),
    [(0.0093, "mis"), (0.0093, "nee"), (0.8, "mis"), (0.8, "nee"), (0.8, "brdf")],  # BRDF samples never hit a small sun
)
def test_sun_over_lambert_floor(picture, diameter, strategy):
    sun = sv.DirectionalLight(
        direction=(1, -1.5, 0.3), illuminance=1000, color=(1, 0.8, 0.6), angular_diameter=diameter
    )
    scene = floor_scene(sv.Material(base_color=0.6), sun)
    samples = 8192 if strategy == "brdf" else 128
    made = picture(scene, (16, 16), samples, max_bounces=1, lambert=True, light_strategy=strategy)
    cosine = 1.5 / math.sqrt(1 + 1.5**2 + 0.3**2)
    irradiance = closed_forms.sun_irradiance(1000, diameter, cosine)
    expected = irradiance * 0.6 / math.pi * np.array((1, 0.8, 0.6))
    expect(made, expected, f"{diameter} {strategy}", 0.01 if strategy == "brdf" else BAR)


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
    assert replicates(tiles, expected[0], BAR) == (0, True)
    independent = math.sqrt(runs.var(axis=0, ddof=1).sum()) / 32**2
    assert runs.mean(axis=(1, 2)).std(ddof=1) / independent == pytest.approx(1, abs=0.45)
