"""Pictures that must agree: with all light strategies, at all scales, mirrored, and with transforms in vertices."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.statistics import assert_equal, compare

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import cornell_box, lamp, matte, place

SETTINGS = {"max_bounces": 3}


def room(lamps=None, *suns):
    """A room of 4 x 3 x 4 m with a glossy ball, a metal box and lamps; with suns, only its floor and back wall."""
    scene = sv.Scene()
    walls = shapes.box((-2, 0, -2), (2, 3, 2), inward=True)
    if suns:
        walls = shapes.polygons(
            [(-2, 0, 2), (2, 0, 2), (2, 0, -2), (-2, 0, -2)], [(-2, 0, -2), (2, 0, -2), (2, 3, -2), (-2, 3, -2)]
        )
    scene.add(sv.Instance(mesh=walls, material=matte((0.7, 0.6, 0.5)), name="walls"))
    ball = shapes.sphere(0.6, 32)
    glossy = sv.Material(base_color=(0.2, 0.4, 0.7), perceptual_roughness=0.5)
    metal = sv.Material(base_color=(0.9, 0.7, 0.3), metallic=1.0, perceptual_roughness=0.6)
    scene.add(sv.Instance(mesh=ball, material=glossy, transform=place(at=(-0.8, 0.6, 0)), name="glossy"))
    scene.add(sv.Instance(mesh=shapes.box(), material=metal, transform=place((0.8, 1.6, 0.8), (0.8, 0.8, -0.5), 0.4)))
    for light in default_lamps() if lamps is None else lamps:
        scene.add(light)
    for sun in suns:
        scene.add(sun)
    scene.add(sv.Camera.look_at((0, 1.5, 1.9), (0, 0.8, -1), vertical_fov=math.radians(70)))
    return scene


def ceiling_lamp(x0, x1, z0, z1, radiance):
    corners = [(x0, 2.9, z0), (x1, 2.9, z0), (x1, 2.9, z1), (x0, 2.9, z1)]
    return sv.Instance(mesh=shapes.polygons(corners), material=lamp(radiance))


def default_lamps():
    ball = sv.Instance(mesh=shapes.sphere(0.3, 12), material=lamp((1, 2, 4)), transform=place(at=(1.4, 1.8, 0.6)))
    return [ceiling_lamp(-1.2, 0.8, -1, 1, (3, 2.5, 2)), ball]


def same(first, second, bar, what="", tile=8):
    result = compare(first.mean, first.variance, second.mean, second.variance, tile)
    print(what, result)
    assert_equal(result, bar, what)


@pytest.fixture(scope="module")
def reference(picture):
    return picture(room(), (48, 48), 256, seed=1, **SETTINGS)


@pytest.fixture(scope="module")
def unscaled(picture):
    return picture(cornell_box(), (48, 48), 64, seed=5, **SETTINGS)


@pytest.mark.parametrize("strategy", ["nee", "brdf"])
def test_strategies_agree(picture, reference, strategy):
    other = picture(room(), (48, 48), 256, seed=2, light_strategy=strategy, **SETTINGS)
    same(other, reference, 0.015, strategy)


def test_strategies_agree_under_wide_suns(picture):
    suns = [
        sv.DirectionalLight(direction=(-1, -2, -0.5), illuminance=20, color=(1, 0.9, 0.7), angular_diameter=1.0),
        sv.DirectionalLight(direction=(1, -1, -1), illuminance=5, color=(0.5, 0.7, 1), angular_diameter=0.6),
    ]
    # With lamps and suns together, the probability of choosing each kind enters every weight.
    scene = room(default_lamps(), *suns)
    mis, nee, brdf = (
        picture(scene, (48, 48), 128, seed=seed, light_strategy=strategy, **SETTINGS)
        for seed, strategy in enumerate(("mis", "nee", "brdf"), 3)
    )
    same(nee, mis, 0.015, "nee")
    same(brdf, mis, 0.03, "brdf")


@pytest.mark.parametrize("scale", [1e-3, 1e4])
def test_scaled_scenes_give_the_same_picture(picture, unscaled, scale):
    """With one seed, nearly all pixels are equal; rounding moves only a few rays to the other side of an edge."""
    scaled = picture(cornell_box(size=2 * scale), (48, 48), 64, seed=5, **SETTINGS)
    relative = np.abs(scaled.mean - unscaled.mean) / (unscaled.mean + 1e-3)
    print(scale, scaled.mean.mean() / unscaled.mean.mean() - 1, (relative > 1e-3).mean())
    assert scaled.mean.mean() == pytest.approx(unscaled.mean.mean(), rel=0.003)
    same(scaled, unscaled, 0.03)
    assert (relative > 0.05).mean() < 0.02


def mirrored(scene, mirror, proper):
    """The scene and its camera, reflected by a matrix. proper: keep the camera's transform a rotation, which flips the
    picture; otherwise the camera is mirrored too, and the picture stays the same."""
    other = sv.Scene()
    for instance in scene:
        other.add(sv.Instance(mesh=instance.mesh, material=instance.material, transform=mirror @ instance.transform))
    flip = np.diag((-1.0, 1, 1, 1)) if proper else np.eye(4)
    camera = scene.camera
    other.add(sv.Camera(transform=mirror @ camera.transform @ flip, vertical_fov=camera.vertical_fov))
    return other


@pytest.mark.parametrize("proper", [True, False])
def test_mirrored_world_and_camera(picture, reference, proper):
    made = picture(mirrored(room(), np.diag((-1.0, 1, 1, 1)), proper), (48, 48), 128, seed=6, **SETTINGS)
    if proper:
        made.runs = made.runs[:, :, ::-1]
    same(made, reference, 0.015, f"proper {proper}")


def baked(instance):
    """The same surface with the transform applied to its vertices. Mirroring reverses triangles, so that fronts stay
    fronts."""
    linear = instance.transform[:3, :3]
    mesh = instance.mesh
    triangles = mesh.triangles if np.linalg.det(linear) > 0 else mesh.triangles[:, ::-1]
    return sv.Instance(
        mesh=sv.Mesh(
            positions=mesh.positions @ linear.T + instance.transform[:3, 3],
            # Not normalized, because shaders interpolate an instance's normals before they transform them.
            normals=mesh.normals @ np.linalg.inv(linear),
            uvs=mesh.uvs,
            indices=triangles,
        ),
        material=instance.material,
    )


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


def test_instances_equal_their_baked_meshes(picture, tracer):
    """Two of the instances are lights, since lights have their own code for transforms."""
    ball = shapes.sphere(0.7, 16)
    paint = sv.Material(base_color=(0.5, 0.7, 0.3), perceptual_roughness=0.4)
    made = []
    for bake in (False, True):
        scene = room([])
        for name, transform in TRANSFORMS.items():
            material = lamp((3, 2, 1)) if name in ("scaled", "mirrored and sheared") else paint
            instance = sv.Instance(mesh=ball, material=material, transform=transform)
            scene.add(baked(instance) if bake else instance)
        made.append((scene, picture(scene, (48, 48), 128, seed=10 + bake, **SETTINGS)))
    same(made[0][1], made[1][1], 0.01, "instances")
    renderers = [tracer(scene, (48, 48)) for scene, _ in made]
    for renderer, (scene, _) in zip(renderers, made, strict=True):
        renderer.render(scene.camera, samples=1)
    for name in ("depth", "position", "geometric_normal", "shading_normal"):
        first, second = (renderer[name] for renderer in renderers)
        alike = np.isclose(first, second, rtol=1e-3, atol=2e-3)
        assert alike.mean() > 0.995, f"{name}: {1 - alike.mean():.3%} differ"
