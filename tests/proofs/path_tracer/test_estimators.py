"""Pictures that must agree: with all light strategies, at all scales, mirrored, and with transforms in vertices."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from support.frames import path_traced_runs
from support.seeded_bugs import Bug, bug_tests
from support.statistics import assert_equal, compare

import solari_vk as sv
from solari_vk.output.error import luminance
from solari_vk.scene import shapes
from solari_vk.scene.builtin import cornell_box, lamp, matte, place

SIZE = (48, 48)


def take(device, scene, samples, seed, **settings):
    return path_traced_runs(device, scene, SIZE, samples, seed=seed, max_bounces=3, **settings)


def room(lamps=None, *suns):
    """A room of 4 x 3 x 4 m with a glossy ball, a metal box and lamps; with suns, only its floor and back wall."""
    walls = shapes.box((-2, 0, -2), (2, 3, 2), inward=True)
    if suns:
        walls = shapes.polygons(
            [(-2, 0, 2), (2, 0, 2), (2, 0, -2), (-2, 0, -2)], [(-2, 0, -2), (2, 0, -2), (2, 3, -2), (-2, 3, -2)]
        )
    glossy = sv.Material(base_color=(0.2, 0.4, 0.7), perceptual_roughness=0.5)
    metal = sv.Material(base_color=(0.9, 0.7, 0.3), metallic=1.0, perceptual_roughness=0.6)
    scene = sv.Scene(*(default_lamps() if lamps is None else lamps), *suns)
    scene.add(walls, matte((0.7, 0.6, 0.5)))
    scene.add(shapes.sphere(0.6, 32), glossy, (-0.8, 0.6, 0))
    scene.add(shapes.box(), metal, place((0.8, 1.6, 0.8), (0.8, 0.8, -0.5), 0.4))
    scene.add(sv.Camera.look_at((0, 1.5, 1.9), (0, 0.8, -1), vertical_fov=math.radians(70)))
    return scene


def default_lamps():
    ceiling = shapes.polygons([(-1.2, 2.9, -1), (0.8, 2.9, -1), (0.8, 2.9, 1), (-1.2, 2.9, 1)])
    ball = sv.Instance(mesh=shapes.sphere(0.3, 12), material=lamp((1, 2, 4)), transform=place(at=(1.4, 1.8, 0.6)))
    return [sv.Instance(mesh=ceiling, material=lamp((3, 2.5, 2))), ball]


def same(first, second, bar, what=""):
    result = compare(first.mean, first.variance, second.mean, second.variance, 8)
    print(what, result)
    assert_equal(result, bar, what)


@pytest.fixture(scope="module")
def reference(device):
    return take(device, room(), 128, seed=1)


def test_light_strategies_agree(device):
    """With lamps and wide suns together, the probability of choosing each kind enters every weight."""
    suns = [
        sv.DirectionalLight(direction=(-1, -2, -0.5), illuminance=20, color=(1, 0.9, 0.7), angular_diameter=1.0),
        sv.DirectionalLight(direction=(1, -1, -1), illuminance=5, color=(0.5, 0.7, 1), angular_diameter=0.6),
    ]
    mis, nee, brdf = (
        take(device, room(None, *suns), 128, seed, light_strategy=strategy)
        for seed, strategy in enumerate(("mis", "nee", "brdf"), 3)
    )
    same(nee, mis, 0.015, "nee")
    same(brdf, mis, 0.03, "brdf")


@pytest.mark.slow
def test_light_strategies_agree_among_many_lamps(device):
    """Near a lamp the tree chooses it much more often than its power would."""
    places = itertools.product((-1.8, -0.6, 0.6, 1.8), (0.4,), (-1, 0.3, 1.6))
    scene = room([sv.Instance(shapes.sphere(0.15, 8), lamp(4.0), place(at=at)) for at in places])
    mis, nee = (take(device, scene, 128, seed, light_strategy=name) for seed, name in enumerate(("mis", "nee")))
    same(nee, mis, 0.015)


def test_mis_has_less_noise_than_either_strategy(device):
    """Of balls from smooth to rough: light samples rarely match narrow lobes, BRDF samples rarely find small lamps."""
    noise = {}
    for strategy in ("mis", "nee", "brdf"):
        with sv.PathTracer(device, sv.builtin("sphere_grid"), (48, 32), seed=7, light_strategy=strategy) as tracer:
            frame = tracer.render(samples=64)
            noise[strategy] = frame["variance"].mean() / luminance(frame["radiance"]).mean() ** 2
    print(noise)
    assert noise["mis"] < 0.6 * min(noise["nee"], noise["brdf"])


def test_samples_of_a_seed_are_more_even_than_independent_ones(device):
    """The variance over seeds against that of independent samples: with 64 samples it is about half."""
    with sv.PathTracer(device, cornell_box(), (24, 24)) as renderer:
        pictures, independent = [], []
        for renderer.seed in range(12):
            frame = renderer.render(samples=64)
            pictures.append(luminance(frame["radiance"]))
            independent.append(frame["variance"])
    light = np.mean(pictures, axis=0) ** 2
    ratio = (np.var(pictures, axis=0, ddof=1) / light).mean() / (np.mean(independent, axis=0) / light).mean()
    print(ratio)
    assert ratio < 0.7


@pytest.mark.slow
def test_merged_lamps_are_as_good_as_separate_ones(device):
    """Lamps in one mesh give the same light with the same error: clusters of its triangles are chosen as lamps are."""
    places = itertools.product((-1.8, -0.6, 0.6, 1.8), (0.4,), (-1, 0.3, 1.6))
    separate = [sv.Instance(shapes.sphere(0.1, 12), lamp(4.0), place(at=at)) for at in places]
    meshes, size = [baked(each).mesh for each in separate], len(separate[0].mesh.positions)
    positions = np.concatenate([mesh.positions for mesh in meshes])
    triangles = np.concatenate([mesh.triangles + size * index for index, mesh in enumerate(meshes)])
    normals = np.concatenate([mesh.normals for mesh in meshes])
    merged = [sv.Instance(sv.Mesh(positions, triangles, normals=normals), lamp(4.0))]
    pictures = [take(device, room(lamps), 256, seed=12 + len(lamps)) for lamps in (separate, merged)]
    same(*pictures, 0.015)
    errors = [float((made.variance / made.mean**2).mean()) for made in pictures]
    print("squared relative error, separate and merged:", errors)
    assert errors[1] < 1.1 * errors[0]


def test_scaled_scenes_give_the_same_picture(device):
    """With one seed, nearly all pixels are equal; rounding moves only a few rays to the other side of an edge."""
    unscaled, *others = (take(device, cornell_box(size=2 * scale), 64, seed=5) for scale in (1, 1e-3, 1e4))
    for scaled in others:
        relative = np.abs(scaled.mean - unscaled.mean) / (unscaled.mean + 1e-3)
        assert scaled.mean.mean() == pytest.approx(unscaled.mean.mean(), rel=0.003)
        same(scaled, unscaled, 0.03)
        assert (relative > 0.05).mean() < 0.02


@pytest.mark.parametrize("proper", [pytest.param(True, marks=pytest.mark.slow), False])
def test_mirrored_world_and_camera(device, reference, proper):
    """proper: the camera's transform stays a rotation, which flips the picture; otherwise the camera is mirrored too,
    and the picture stays the same."""
    scene, mirror = room(), np.diag((-1.0, 1, 1, 1))
    for instance in scene:
        instance.transform = mirror @ instance.transform
    scene.camera.transform = mirror @ scene.camera.transform @ (mirror if proper else np.eye(4))
    made = take(device, scene, 64, seed=6)
    if proper:
        made.runs = made.runs[:, :, ::-1]
    same(made, reference, 0.015, f"proper {proper}")


def baked(instance):
    """The same surface with the transform applied to its vertices. Mirroring reverses triangles, so that fronts stay
    fronts."""
    linear, mesh = instance.transform[:3, :3], instance.mesh
    triangles = mesh.triangles if np.linalg.det(linear) > 0 else mesh.triangles[:, ::-1]
    positions = mesh.positions @ linear.T + instance.transform[:3, 3]
    # Not normalized, because shaders interpolate an instance's normals before they transform them.
    normals = mesh.normals @ np.linalg.inv(linear)
    return sv.Instance(sv.Mesh(positions, triangles, normals=normals), instance.material)


def bent(matrix, at):
    transform = np.eye(4)
    transform[:3, :3] = matrix
    transform[:3, 3] = at
    return transform


TRANSFORMS = {
    "mirrored": bent(np.diag((-0.7, 0.7, 0.7)), (-0.9, 0.9, 0)),
    "scaled": bent(np.diag((0.3, 1.1, 0.6)), (0.9, 1.0, 0)),
    "sheared": bent([(0.6, 0.5, 0), (0, 0.6, 0), (0.2, 0, 0.6)], (0, 0.6, -0.9)),
    "mirrored and sheared": bent([(0.5, 0.4, 0), (0, -0.5, 0), (0.1, 0, 0.5)], (0.2, 2.0, -0.8)),
}


def test_instances_equal_their_baked_meshes(device):
    """Two of the instances are lights, since lights have their own code for transforms."""
    paint = sv.Material(base_color=(0.5, 0.7, 0.3), perceptual_roughness=0.4)
    pictures, outputs = [], []
    for bake in (False, True):
        scene = room([])
        for name, transform in TRANSFORMS.items():
            material = lamp((3, 2, 1)) if name in ("scaled", "mirrored and sheared") else paint
            instance = sv.Instance(mesh=shapes.sphere(0.7, 16), material=material, transform=transform)
            scene.add(baked(instance) if bake else instance)
        pictures.append(take(device, scene, 64, seed=10 + bake))
        with sv.PathTracer(device, scene, SIZE) as tracer:
            tracer.render(samples=1)
            names = ("depth", "position", "geometric_normal", "shading_normal")
            outputs.append({name: tracer[name].copy() for name in names})
    same(*pictures, 0.01)
    for name, first in outputs[0].items():
        alike = np.isclose(first, outputs[1][name], rtol=1e-3, atol=2e-3)
        assert alike.mean() > 0.995, f"{name}: {1 - alike.mean():.3%} differ"


test_a_seeded_bug_is_noticed = bug_tests(
    {
        "lights are chosen as MIS believes": (
            test_light_strategies_agree_among_many_lamps,
            Bug("scene/walk.glsl", "hit_light_pdf(Receiver", "return emissive_hit_pdf(surface, direction, hit.t);"),
        ),
        "random numbers of a path's samples are independent": (
            test_samples_of_a_seed_are_more_even_than_independent_ones,
            Bug(
                "common/sobol.glsl",
                "sobol_point",
                "uint state = seed ^ pcg(index); return vec2(unit_float(pcg(state)), unit_float(pcg(state + 1u)));",
            ),
        ),
        "mirrored instances: front and back are exchanged": (
            test_instances_equal_their_baked_meshes,
            Bug(
                "scene/surface.glsl",
                "resolve_triangle",
                "TrianglePoint point = correct(instance, mesh, triangle, barycentrics); "
                "if (determinant(mat3(instance.world_from_object)) < 0.0) { point.geometric_world_normal *= -1.0; } "
                "return point;",
            ),
        ),
    }
)
