"""The path tracer: series in closed boxes, energy of all materials, and light-tight surfaces."""

from __future__ import annotations

import math

import numpy as np
import pytest
from oracles.light import closed_box_radiance
from support.frames import path_traced_runs
from support.seeded_bugs import Bug, Measurement, Rule, bug_tests, require

import solari_vk as sv
from solari_vk.lab.structures import bumpy_ball
from solari_vk.scene import shapes
from solari_vk.scene.builtin import closed_box, matte, place

BAR = 0.005
_SERIES = ("closed form", "geometric series in a closed room")


def measure_series(device, bounces, strategy):
    """Le (1 + rho + ... + rho^k) everywhere in a closed Lambert room, whatever the strategy.

    Light samples alone are measured in a ball. Close to an edge between two walls, one sample can be brighter than all
    others together: their variance is infinite, and the probability of such a sample grows with the square of the angle
    between the walls. In a box 0.5 % is often exceeded; in this ball in 1 of 2,000, and one standard deviation
    is 0.06 %.
    """
    albedo, emission = np.array((0.3, 0.5, 0.7)), np.array((2.0, 1.0, 0.25))
    expected = closed_box_radiance(emission, albedo, bounces)
    scene, samples = closed_box(), 512
    if strategy == "nee":
        ball = shapes.sphere(segments=128)
        scene.instances[0].mesh = sv.Mesh(ball.positions, ball.triangles[:, ::-1])  # faces inward
        samples = 128
    scene.materials[0].update(base_color=albedo, emissive=emission)
    options = {"max_bounces": bounces, "lambert": True, "light_strategy": strategy}
    made = path_traced_runs(device, scene, (32, 32), samples, **options)
    mean = made.mean.mean(axis=(0, 1)) if bounces else made.mean  # emission alone is exact in every pixel
    error = float(np.abs(mean / expected - 1).max())
    rule = Rule(f"closed room after {bounces} bounces, {strategy}", *_SERIES)
    yield Measurement(rule, error, BAR if bounces else 1e-6, "relative error")


def measure_white_box(device, roughness, metallic):
    """White walls lose no energy: every bounce adds the emission once more, whatever the material."""
    scene = closed_box(1.0, 1.0)
    next(iter(scene)).material.update(perceptual_roughness=roughness, metallic=metallic, reflectance=0.5)
    made = path_traced_runs(device, scene, (32, 32), 128, max_bounces=3)
    rule = Rule(f"white closed box, roughness {roughness:g}, metallic {metallic:g}", *_SERIES)
    yield Measurement(rule, abs(float(made.mean.mean()) / 4 - 1), BAR, "relative error")


# ---- closed surfaces --------------------------------------------------------------------------------

PLACES = {
    "plain": place(),
    "small": place(1e-3),
    "large": place(1e4),
    "far": place(1.0, (1000.0, 1000.0, 1000.0)),
    "stretched": place((10.0, 0.1, 1.0), turn=0.7),
    "mirrored": place((-1.0, 1.0, 1.0)),
}


def ball_with_bumps():
    """Its bumps are low: in a crease sharper than a right angle, an origin that is moved off one side can pass through
    the other."""
    return sv.Mesh(positions=bumpy_ball(40, 0.01)[:, ::-1].reshape(-1, 3))


def ball_with_spikes():
    """Has long, thin and tiny triangles, and vertices that are moved in and out, less so towards the poles."""
    mesh = shapes.sphere(1.0, 48)
    _, same = np.unique(mesh.positions, axis=0, return_inverse=True)
    height = 0.3 * np.hypot(mesh.positions[:, 0], mesh.positions[:, 2])
    radius = 1 + height * np.random.default_rng(2).uniform(-1, 1, same.max() + 1)[same.reshape(-1)]
    return sv.Mesh(positions=mesh.positions * radius[:, None], indices=mesh.triangles[:, ::-1])


def measure_light_tight(device, where, samples=8):
    """Suns surround a closed surface that faces inward, with a camera inside: all light in the picture leaked through a
    wall. Between spikes only camera rays are measured."""
    suns = [
        sv.DirectionalLight(direction=direction, illuminance=1e6, angular_diameter=math.pi)
        for direction in ((0.3, 1, 0.2), (-0.3, -1, -0.2))
    ]
    camera = sv.Camera(transform=place(at=PLACES[where][:3, 3]), vertical_fov=2.6, near=1e-6)
    for mesh, bounces, size in ((ball_with_bumps(), 4, (64, 64)), (ball_with_spikes(), 0, (256, 256))):
        ball = sv.Instance(mesh=mesh, material=matte(1.0), transform=PLACES[where])
        options = {"max_bounces": bounces, "lambert": True, "runs": 2}
        made = path_traced_runs(device, sv.Scene(ball, camera, *suns), size, samples, **options)
        lit = float((made.mean > 0).any(axis=-1).sum())
        yield Measurement(Rule(f"a closed surface is light-tight, {where}"), lit, 0.0, "pixels")
    outside = path_traced_runs(device, sv.Scene(camera, *suns), (16, 16), 2, max_bounces=0, runs=2).mean
    yield Measurement(Rule("the suns are seen"), float((outside == 0).sum()), 0.0, "dark pixels")


# ---- each rule holds, and can fail --------------------------------------------------------------------


def slow(*case):
    return pytest.param(*case, marks=pytest.mark.slow)


@pytest.mark.parametrize(
    ("bounces", "strategy"),
    [(0, "mis"), (1, "mis"), (1, "nee"), (1, "brdf"), slow(5, "mis"), slow(5, "nee"), slow(5, "brdf")],
)
def test_series(device, bounces, strategy):
    require(measure_series(device, bounces, strategy))


@pytest.mark.parametrize(
    ("roughness", "metallic"),
    [
        (0.5, 0.0),
        (0.15, 1.0),
        *(slow(*case) for case in ((0.0, 0.0), (0.0, 0.5), (0.15, 0.5), (0.5, 0.5), (1.0, 0.0), (1.0, 1.0))),
    ],
)
def test_white_boxes(device, roughness, metallic):
    require(measure_white_box(device, roughness, metallic))


@pytest.mark.parametrize("samples", [8, slow(64)])
@pytest.mark.parametrize("where", PLACES)
def test_closed_surfaces_are_light_tight(device, where, samples):
    require(measure_light_tight(device, where, samples))


test_a_seeded_bug_is_noticed = bug_tests(
    {
        "light samples in a closed room": (
            lambda device: measure_series(device, 1, "nee"),
            Bug(
                "scene/sampling.glsl",
                "resolve_light_sample(LightSample light_sample, float",
                "ResolvedLightSample found = correct(light_sample, leaf_probability); found.inverse_area_pdf *= 1.02; "
                "return found;",
            ),
        ),
        "weights of hits": (
            lambda device: measure_series(device, 5, "mis"),
            Bug("scene/walk.glsl", "emitted_light", "return correct(walk, surface, 0.0);"),
        ),
        "white walls": (
            lambda device: measure_white_box(device, 0.5, 0.0),
            Bug("scene/lobes/specular.glsl", "dielectric_albedo", "return 0.5 * correct(specular, ab, cosine);"),
        ),
        "white metal": (
            lambda device: measure_white_box(device, 1.0, 1.0),
            Bug("scene/brdf_table.glsl", "lookup_brdf_table", "return vec2(1.0, 0.0);"),
        ),
        "light-tight": (
            lambda device: measure_light_tight(device, "far"),
            Bug("scene/surface.glsl", "world_ray_offset", "return 0.0;"),
        ),
        "shadows": (
            lambda device: measure_light_tight(device, "plain"),
            Bug("scene/light_visibility.glsl", "trace_light_transmittance", "return vec3(1.0);"),
        ),
    }
)
