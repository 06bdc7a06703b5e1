"""Camera rays against Embree's, and closed surfaces and walls that no ray gets through."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support import rays
from test_closed_boxes import PLACES

import solari_vk as sv
from solari_vk.conformance.embree_checks import meet
from solari_vk.scene import shapes
from solari_vk.scene.builtin import builtin, matte, place

SIZE = 192


def jumble():
    """Spheres and boxes that intersect each other, with random rotations, mirrorings, scales and shears."""
    random = np.random.default_rng(11)
    scene = sv.Scene()
    for i in range(60):
        transform = np.eye(4)
        transform[:3, :3] = random.normal(size=(3, 3)) * 0.6
        transform[:3, 3] = random.uniform(-3, 3, 3)
        mesh = shapes.sphere(1.0, 24) if i % 2 else shapes.box()
        scene.add(sv.Instance(mesh=mesh, material=sv.Material(), transform=transform))
    return scene


SCENES = {
    "cornell_box": lambda: builtin("cornell_box"),
    "many_lights": lambda: builtin("many_lights", sphere_count=100, box_count=2000, extent=30),
    "jumble": jumble,
}


def cameras_in(scene, count, seed):
    """Random cameras inside the scene's bounds and around them."""
    random = np.random.default_rng(seed)
    low, high = scene.bounds
    for _ in range(count):
        eye = random.uniform(low - 0.3 * (high - low), high + 0.3 * (high - low))
        target = random.uniform(low + 0.3 * (high - low), high - 0.3 * (high - low))
        yield sv.Camera.look_at(eye, target, vertical_fov=random.uniform(0.6, 1.8), near=1e-6)


@pytest.mark.parametrize("name", SCENES)
def test_camera_rays_hit_what_embree_hits(tracer, name):
    """The instances and distances of 1e5 rays are Embree's. Rays may differ that hit two surfaces at equal distance, or
    hit near an edge, within 1e-4 of the scene's extent."""
    scene = SCENES[name]()
    for instance in scene:
        instance.material.update(double_sided=True)  # the Embree rays aren't culled
    world = rays.World(scene)
    low, high = scene.bounds
    extent = float(np.linalg.norm(high - low))
    renderer = tracer(scene, (SIZE, SIZE), max_bounces=0)
    total, wrong = 0, 0
    for camera in cameras_in(scene, 3, seed=21):
        renderer.render(camera, samples=1)
        origins, directions = (x.reshape(-1, 3) for x in rays.camera_rays(camera, SIZE, SIZE))
        hits = world.embree_hits(origins, directions)
        distance, edge = meet(world.corners, hits, origins, directions)
        expected = np.where(hits >= 0, world.instance[np.maximum(hits, 0)], -1)
        seen = renderer["instance_id"].reshape(-1).astype(np.int64)
        seen = np.where(seen >= len(scene.instances), -1, seen)
        position = renderer["position"].reshape(-1, 3)[:, :3].astype(np.float64)
        found = np.linalg.norm(position - origins, axis=1)
        both = (seen >= 0) & (expected >= 0)
        far_off = both & (np.abs(found - distance) > 1e-4 * (extent + distance))
        differs = (seen != expected) | far_off
        # Where two surfaces coincide, either is right.
        coincident = both & (np.abs(found - distance) <= 1e-6 * (extent + distance))
        wrong += int((differs & ~(edge < 1e-4 * extent) & ~coincident).sum())
        total += len(hits)
        along = np.einsum("ij,ij->i", position - origins, -camera.transform[:3, 2][None])
        good = both & ~differs
        assert good.any(), "no ray hit what Embree says"
        np.testing.assert_allclose(renderer["depth"].reshape(-1)[good], along[good], rtol=1e-3, atol=1e-4 * extent)
        normals = renderer["geometric_normal"].reshape(-1, 3)[good]
        facing = np.abs(np.einsum("ij,ij->i", normals, world.normals[hits[good]]))
        assert np.quantile(facing, 0.001) > 0.999
    print(name, total, wrong)
    assert wrong / total < 1e-4


def spiky_ball():
    """A closed ball whose fronts face inward, with long, thin and tiny triangles and vertices moved in and out."""
    mesh = shapes.sphere(1.0, 48)
    random = np.random.default_rng(2)
    _, same = np.unique(mesh.positions, axis=0, return_inverse=True)
    # Spikes are lower towards the poles, where triangles are small.
    height = 0.3 * np.hypot(mesh.positions[:, 0], mesh.positions[:, 2])
    radius = 1 + height * random.uniform(-1, 1, same.max() + 1)[same.reshape(-1)]
    return sv.Mesh(positions=mesh.positions * radius[:, None], indices=mesh.triangles[:, ::-1])


def all_around_suns():
    """Two suns whose disks cover all directions, so that each ray that meets no surface is bright."""
    for direction in ((0.3, 1, 0.2), (-0.3, -1, -0.2)):
        yield sv.DirectionalLight(direction=direction, illuminance=1e6, angular_diameter=math.pi)


@pytest.mark.parametrize("where", PLACES)
def test_camera_rays_find_no_gap_between_spikes(tracer, where):
    """None of 1e6 rays at edges of all kinds passes through a gap, behind which it would see a sun."""
    ball = sv.Instance(mesh=spiky_ball(), material=matte(1.0), transform=PLACES[where])
    camera = sv.Camera(transform=place(at=PLACES[where][:3, 3]), vertical_fov=2.6, near=1e-6)
    renderer = tracer(sv.Scene(ball, *all_around_suns()), (256, 256), max_bounces=0, lambert=True)
    assert (renderer.render(camera, samples=16)["radiance"] == 0).all()


def test_suns_are_seen_outside(tracer):
    """A control of the tests above: without the surface, everything is bright."""
    renderer = tracer(sv.Scene(*all_around_suns()), (16, 16), max_bounces=0)
    assert (renderer.render(sv.Camera(), samples=1)["radiance"] > 0).all()


def test_thin_wall_keeps_its_dark_side_black(tracer):
    scene = builtin("thin_wall", thickness=0.001)
    renderer = tracer(scene, (128, 64), max_bounces=5)
    radiance = renderer.render(scene.camera, samples=32)["radiance"]
    x = renderer["position"][..., 0]
    wall = renderer["instance_id"] == 1
    room = (renderer["instance_id"] == 0) | wall
    # Excludes the pixels at the wall itself, whose samples fall on both sides of it.
    dark, lit = room & (x > 0.1), room & (x < -0.1)
    assert dark.sum() > 500
    assert (radiance[dark] == 0).all()
    assert np.median(radiance[lit]) > 0.1


def test_backs_are_culled_for_camera_rays_only(tracer):
    """The camera sees through the back of a single-sided wall, but that back still stops the sun's light."""
    wall = sv.Instance(mesh=shapes.quad((0, 0, -2), (-9, 0, 0), (0, 9, 0)), material=matte(0.8), name="wall")
    back = sv.Instance(mesh=shapes.quad((0, 0, -4), (9, 0, 0), (0, 9, 0)), material=matte(0.8), name="back")
    lamp = sv.DirectionalLight(direction=(0, 0, -1), illuminance=100)
    scene = sv.Scene(wall, back, lamp)
    camera = sv.Camera(vertical_fov=0.5)
    renderer = tracer(scene, (8, 8), max_bounces=1, lambert=True)
    assert (renderer.render(camera, samples=8)["radiance"] == 0).all(), "the wall's back stops the sun"
    assert (renderer["instance_id"] == 1).all(), "the camera looks through the wall's back"
    wall.material.update(double_sided=True)
    assert (renderer.render(camera, samples=8)["radiance"] > 0).all()
    assert (renderer["instance_id"] == 0).all()
    np.testing.assert_allclose(renderer["depth"], 2, rtol=1e-5)
