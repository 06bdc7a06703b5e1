"""The path tracer's restarts after edits, noise and its estimate, and finite pictures of broken scenes."""

from __future__ import annotations

import numpy as np
import pytest
from support.frames import path_traced
from support.scenes import random_items
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import closed_box, cornell_box, lamp, matte, place


def fresh(tracer, scene, samples=4, **settings):
    return tracer(scene, (32, 32), **settings).render(samples=samples)["radiance"]


def test_pixels_and_seeds_are_independent(device):
    """The noise of neighboring pixels is uncorrelated, and so is that of successive seeds."""
    noise = [path_traced(device, closed_box(), 1, (64, 64), seed=seed, max_bounces=2)[..., 0] for seed in (1, 2, 3)]
    first, *others = (n - n.mean() for n in noise)
    for other in (np.roll(first, 1, 0), np.roll(first, 1, 1), np.roll(first, (1, 1), (0, 1)), *others):
        assert abs((first * other).mean() / (first.std() * other.std())) < 4.5 / 64


SUN = sv.DirectionalLight(direction=(0.2, -0.3, 1), illuminance=20)
BALL = sv.Instance(mesh=shapes.sphere(0.3, 12), material=lamp((3, 0, 9)), transform=place(at=(1, 1, 0.4)))
EDITS = {
    "material": lambda scene: next(iter(scene)).material.update(base_color=(0.1, 0.6, 0.2)),
    "transform": lambda scene: scene.instances["short block"].update(transform=place(at=(0.1, 0.2, -0.1))),
    "remove": lambda scene: scene.remove(scene.instances["tall block"]),
    "add": lambda scene: scene.add(BALL),
    "radiance of a light": lambda scene: scene.instances["lamp"].material.update(emissive=(1, 5, 9)),
    "hide": lambda scene: scene.instances["short block"].update(visible=False),
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
    """The variance is that of independent samples, as those of many seeds are, in three parts of the picture."""
    scene, settings = cornell_box(), {"seed": 5, "max_bounces": 3}
    made = picture(scene, (32, 32), 24 * 16, runs=24 * 16, **settings)
    renderer = tracer(scene, (32, 32), **settings)
    renderer.render(scene.camera, samples=24 * 16)
    estimate = renderer["variance"].astype(np.float64)
    measured = (made.runs @ np.array((0.2126, 0.7152, 0.0722))).var(axis=0, ddof=1) / (24 * 16)
    assert (estimate >= 0).all()
    for rows in (slice(0, 10), slice(10, 22), slice(22, 32)):
        ratio = estimate[rows].sum() / measured[rows].sum()
        print(rows, ratio)
        assert ratio == pytest.approx(1, abs=0.15)


def test_degenerate_triangles_are_harmless(tracer):
    """Meshes of points, lines and slivers don't change the picture, and give no light when they are emissive, nor do
    triangles without area in a lamp."""
    scene = cornell_box()
    expected = fresh(tracer, scene, 256).mean()
    points = np.random.default_rng(1).uniform(0.4, 1.6, (12, 3))
    spoiled = np.concatenate([np.repeat(points[:3], 3, axis=0), points[[3, 4, 3, 5, 5, 6]]])
    for material in (matte(0.5), lamp(5.0)):
        scene.add(sv.Mesh(positions=spoiled), material)
        scene.add(sv.Mesh(positions=spoiled, normals=np.zeros_like(spoiled)), material)
    light = scene.instances["lamp"]
    indices = np.concatenate([light.mesh.indices, [[0, 0, 1], [2, 2, 2]]])
    light.mesh = sv.Mesh(positions=light.mesh.positions, normals=light.mesh.normals, indices=indices)
    assert fresh(tracer, scene, 256).mean() == pytest.approx(expected, rel=0.04)


def test_pictures_of_random_scenes_are_finite(device):
    """Most of them unusual: odd normals, extreme materials and lights, cameras inside things, nothing at all."""
    scene = sv.Scene()
    with sv.PathTracer(device, scene, (16, 16), max_bounces=6) as tracer:
        for number in range(60):
            *items, camera = random_items(np.random.default_rng(number))
            for item in (*scene.instances, *scene.lights):
                scene.remove(item)
            for item in items:
                scene.add(item)
            radiance = tracer.render(camera, samples=4)["radiance"]
            assert np.isfinite(radiance).all(), number
            assert (radiance >= 0).all(), number
            assert items or not radiance.any(), "an empty scene is black"
            met = tracer["instance_id"] < len(scene.instances)
            for name in ("depth", "position", "geometric_normal", "shading_normal", "albedo", "roughness_metallic"):
                assert np.isfinite(tracer[name][met]).all(), (number, name)


test_a_seeded_bug_is_noticed = bug_tests(
    {
        "seeds have no effect": (
            test_pixels_and_seeds_are_independent,
            Bug("common/hash.glsl", "seed_rng", "return correct(pixel, number, 0u);"),
        )
    }
)
