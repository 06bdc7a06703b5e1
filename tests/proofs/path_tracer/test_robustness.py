"""The path tracer's restarts after edits, variance estimate, and finite pictures of broken scenes."""

from __future__ import annotations

import numpy as np
import pytest
from support.frames import find

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import builtin, cornell_box, lamp, matte, place

AOVS = ("depth", "position", "geometric_normal", "shading_normal", "albedo", "roughness_metallic", "emissive")


def fresh(tracer, scene, samples=4, size=(32, 32), camera=None, **settings):
    return tracer(scene, size, **settings).render(camera or scene.camera, samples=samples)["radiance"]


def test_different_frames_and_pixels_are_independent(tracer):
    """The noise of neighboring pixels is uncorrelated, and so is that of successive seeds."""
    scene = builtin("closed_box")
    noise = [fresh(tracer, scene, 1, (64, 64), seed=s, max_bounces=2)[..., 0].astype(np.float64) for s in (1, 2, 3)]
    noise = [n - n.mean() for n in noise]
    first = noise[0]
    for shifted in (np.roll(first, 1, 0), np.roll(first, 1, 1), np.roll(first, (1, 1), (0, 1)), *noise[1:]):
        correlation = (noise[0] * shifted).mean() / (noise[0].std() * shifted.std())
        assert abs(correlation) < 4.5 / 64


SUN = sv.DirectionalLight(direction=(0.2, -0.3, 1), illuminance=20)
BALL = sv.Instance(mesh=shapes.sphere(0.3, 12), material=lamp((3, 0, 9)), transform=place(at=(1, 1, 0.4)))
EDITS = {
    "material": lambda scene: next(iter(scene)).material.update(base_color=(0.1, 0.6, 0.2)),
    "transform": lambda scene: find(scene, "short block").update(transform=place(at=(0.1, 0.2, -0.1))),
    "remove": lambda scene: scene.remove(find(scene, "tall block")),
    "add": lambda scene: scene.add(BALL),
    "radiance of a light": lambda scene: find(scene, "lamp").material.update(emissive=(1, 5, 9)),
    "hide": lambda scene: find(scene, "short block").update(visible=False),
    "new sun": lambda scene: scene.add(SUN),
    "camera": lambda scene: scene.camera.update(vertical_fov=0.5),
}


@pytest.mark.parametrize("edit", EDITS)
def test_edits_restart_the_picture(tracer, edit):
    """After an edit, the picture equals that of a new renderer bit by bit."""
    scene = cornell_box()
    renderer = tracer(scene, (32, 32), seed=3)
    before = renderer.render(scene.camera, samples=3)["radiance"].copy()
    EDITS[edit](scene)
    after = renderer.render(scene.camera, samples=4)["radiance"].copy()
    assert np.abs(after - before).mean() > 1e-4
    np.testing.assert_array_equal(after, fresh(tracer, scene, seed=3))


def test_variance_is_calibrated(picture, tracer):
    """The estimated variance of pixel means agrees with that over independent runs, in three parts of the picture."""
    scene, settings = cornell_box(), {"seed": 5, "max_bounces": 3}
    made = picture(scene, (32, 32), 24 * 16, runs=24, **settings)
    renderer = tracer(scene, (32, 32), **settings)
    frame = renderer.render(scene.camera, samples=24 * 16)
    np.testing.assert_allclose(frame["radiance"], made.mean, rtol=1e-4, atol=1e-5)
    estimate = renderer["variance"].astype(np.float64)
    measured = (made.runs @ np.array((0.2126, 0.7152, 0.0722))).var(axis=0, ddof=1) / 24
    assert (estimate >= 0).all()
    for rows in (slice(0, 10), slice(10, 22), slice(22, 32)):
        ratio = estimate[rows].sum() / measured[rows].sum()
        print(rows, ratio)
        assert ratio == pytest.approx(1, abs=0.15)


def all_finite(tracer, scene, camera=None, samples=8, **settings):
    renderer = tracer(scene, (32, 32), **settings)
    radiance = renderer.render(camera or scene.camera, samples=samples)["radiance"]
    assert np.isfinite(radiance).all()
    assert (radiance >= 0).all()
    for name in AOVS:
        values = renderer[name]
        assert np.isfinite(values[renderer["instance_id"] < len(scene.instances)]).all(), name
    return radiance


def test_degenerate_triangles_are_harmless(tracer):
    """Meshes of points, lines and slivers don't change the picture, and give no light when they are emissive."""
    plain = cornell_box()
    broken = cornell_box()
    random = np.random.default_rng(1)
    points = random.uniform(0.4, 1.6, (12, 3))
    spoiled = np.concatenate([np.repeat(points[:3], 3, axis=0), points[[3, 4, 3, 5, 5, 6]]])
    for material in (matte(0.5), lamp(5.0)):
        broken.add(sv.Instance(mesh=sv.Mesh(positions=spoiled), material=material))
        broken.add(sv.Instance(mesh=sv.Mesh(positions=spoiled, normals=np.zeros_like(spoiled)), material=material))
    radiance = all_finite(tracer, broken, samples=256)
    expected = fresh(tracer, plain, 256)
    assert radiance.mean() == pytest.approx(expected.mean(), rel=0.05)


def test_zero_area_triangles_within_a_lamp(tracer):
    scene = cornell_box()
    light = find(scene, "lamp")
    expected = fresh(tracer, scene, 256)
    whole = light.mesh
    indices = np.concatenate([whole.indices, [[0, 0, 1], [2, 2, 2]]])
    light.mesh = sv.Mesh(positions=whole.positions, normals=whole.normals, indices=indices)
    assert all_finite(tracer, scene, samples=256).mean() == pytest.approx(expected.mean(), rel=0.04)


@pytest.mark.parametrize("normals", ["zero", "opposite", "tangential"])
def test_odd_vertex_normals(tracer, normals):
    ball = shapes.sphere(0.4, 16)
    turned = np.roll(ball.normals, 1, axis=1)
    values = {"zero": 0 * ball.normals, "opposite": -ball.normals, "tangential": turned}[normals]
    scene = cornell_box()
    mesh = sv.Mesh(positions=ball.positions, normals=values, indices=ball.indices)
    for roughness, metallic in ((0.0, 1.0), (0.5, 0.0)):
        material = sv.Material(perceptual_roughness=roughness, metallic=metallic)
        scene.add(sv.Instance(mesh=mesh, material=material, transform=place(at=(0.6 + metallic, 1.3, 0.4))))
    all_finite(tracer, scene, max_bounces=6)


@pytest.mark.parametrize("roughness", [0.0, 0.03, 0.0317, 0.1, 1.0])
def test_extreme_materials(tracer, roughness):
    scene = cornell_box()
    for i, instance in enumerate(scene):
        if not instance.material.emits:
            instance.material.update(
                perceptual_roughness=roughness, metallic=i % 3 / 2, base_color=i % 2, reflectance=i % 4 / 3
            )
    all_finite(tracer, scene, max_bounces=8)


def test_extreme_lights_and_no_lights(tracer):
    for radiance in (1e-30, 1e8):
        all_finite(tracer, cornell_box(radiance=(radiance, 0, radiance)))
    scene = cornell_box()
    scene.remove(find(scene, "lamp"))
    assert (all_finite(tracer, scene) == 0).all()
    assert (all_finite(tracer, sv.Scene(), sv.Camera()) == 0).all(), "an empty scene is black"


def test_camera_in_odd_places(tracer):
    """Pictures are finite from a wall's surface, a lamp's plane, the inside of a block, and far away."""
    scene = cornell_box()
    for eye in ((1.0, 0.0, 1.0), (1.0, 2.0, 1.0), (0.65, 0.3, 0.6), (1e5, 1e5, -1e5)):
        camera = sv.Camera.look_at(eye, (1.0, 0.9, 1.1))
        all_finite(tracer, scene, camera)
