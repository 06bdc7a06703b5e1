"""Camera rays against Embree's, walls that no light gets through, and the two ways to trace rays."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.rays import World, camera_rays
from support.frames import each_lighting, make_renderer, snapshot

import solari_vk as sv
from solari_vk.lab.embree import intersect_planes
from solari_vk.scene import shapes
from solari_vk.scene.builtin import builtin, matte

SIZE = 192


def jumble():
    """Spheres and boxes that intersect each other, with random rotations, mirrorings, scales and shears."""
    random = np.random.default_rng(11)
    scene = sv.Scene()
    for i in range(60):
        transform = np.eye(4)
        transform[:3, :3] = random.normal(size=(3, 3)) * 0.6
        transform[:3, 3] = random.uniform(-3, 3, 3)
        scene.add(shapes.sphere(1.0, 24) if i % 2 else shapes.box(), sv.Material(), transform)
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
    world = World(scene)
    extent = float(np.linalg.norm(np.subtract(*scene.bounds)))
    renderer = tracer(scene, (SIZE, SIZE), max_bounces=0)
    total, wrong = 0, 0
    for camera in cameras_in(scene, 3, seed=21):
        renderer.render(camera, samples=1)
        origins, directions = (x.reshape(-1, 3) for x in camera_rays(camera, SIZE, SIZE))
        hits = world.embree_hits(origins, directions)
        distance, edge = intersect_planes(world.corners, hits, origins, directions)
        expected = np.where(hits >= 0, world.instance[np.maximum(hits, 0)], -1)
        seen = renderer["instance_id"].reshape(-1).astype(np.int64)
        seen = np.where(seen >= len(scene.instances), -1, seen)
        away = renderer["position"].reshape(-1, 3).astype(np.float64) - origins
        both = (seen >= 0) & (expected >= 0)
        apart = np.abs(np.linalg.norm(away, axis=1) - distance)
        differs = (seen != expected) | both & (apart > 1e-4 * (extent + distance))
        coincident = both & (apart <= 1e-6 * (extent + distance))  # either surface is right
        wrong += int((differs & ~(edge < 1e-4 * extent) & ~coincident).sum())
        total += len(hits)
        good = both & ~differs
        assert good.any(), "no ray hit what Embree says"
        along = -away[good] @ camera.transform[:3, 2]
        np.testing.assert_allclose(renderer["depth"].reshape(-1)[good], along, rtol=1e-3, atol=1e-4 * extent)
        normals = renderer["geometric_normal"].reshape(-1, 3)[good]
        facing = np.abs(np.einsum("ij,ij->i", normals, world.normals[hits[good]]))
        assert np.quantile(facing, 0.001) > 0.999
    print(name, total, wrong)
    assert wrong / total < 1e-4


def test_thin_wall_keeps_its_dark_side_black(tracer):
    scene = builtin("thin_wall", thickness=0.001)
    renderer = tracer(scene, (128, 64), max_bounces=5)
    radiance = renderer.render(scene.camera, samples=32)["radiance"]
    x = renderer["position"][..., 0]
    room = renderer["instance_id"] <= 1  # or the wall
    # Excludes the pixels at the wall itself, whose samples fall on both sides of it.
    dark, lit = room & (x > 0.1), room & (x < -0.1)
    assert dark.sum() > 500
    assert (radiance[dark] == 0).all()
    assert np.median(radiance[lit]) > 0.1


def test_backs_are_culled_for_camera_rays_only(tracer):
    """The camera sees through the back of a single-sided wall, but that back still stops the sun's light."""
    wall = sv.Instance(mesh=shapes.quad((0, 0, -2), (-9, 0, 0), (0, 9, 0)), material=matte(0.8), name="wall")
    back = sv.Instance(mesh=shapes.quad((0, 0, -4), (9, 0, 0), (0, 9, 0)), material=matte(0.8), name="back")
    scene = sv.Scene(wall, back, sv.DirectionalLight(direction=(0, 0, -1), illuminance=100))
    camera = sv.Camera(vertical_fov=0.5)
    renderer = tracer(scene, (8, 8), max_bounces=1, lambert=True)
    assert (renderer.render(camera, samples=8)["radiance"] == 0).all(), "the wall's back stops the sun"
    assert (renderer["instance_id"] == 1).all(), "the camera looks through the wall's back"
    wall.material.update(double_sided=True)
    assert (renderer.render(camera, samples=8)["radiance"] > 0).all()
    assert (renderer["instance_id"] == 0).all()
    np.testing.assert_allclose(renderer["depth"], 2, rtol=1e-5)


# ---- both ways to trace ------------------------------------------------------------------------------


def pictures_by(way, lighting):
    """The path tracer's picture, or frames with some lighting, of glass and all kinds of lights."""
    scene = builtin("cornell_box")
    glass = {"transmission": 1.0, "perceptual_roughness": 0.0, "double_sided": True}
    solid = {**glass, "solid": True, "attenuation_color": (0.9, 0.5, 0.2), "attenuation_distance": 0.5}
    scene.add(shapes.sphere(0.3, 16), sv.Material(**solid), (0.6, 1.5, 0.6))
    scene.add(shapes.quad((1, 1, 0.2), (0.5, 0, 0), (0, 0.5, 0)), sv.Material(base_color=(0.9, 0.5, 0.2), **glass))
    scene.add(sv.PointLight((1.5, 1.3, 1.6), intensity=2))
    scene.add(sv.SpotLight((0.5, 1.9, 1.3), (0.1, -1, -0.1), intensity=10))
    scene.add(sv.PointLight((0.6, 1.1, 1.2), intensity=3, radius=0.15))
    scene.environment = sv.Environment(np.random.default_rng(4).random((8, 16, 3)).astype(np.float32))
    with sv.Device(validation=True, rays=way) as device:
        if lighting is None:
            with sv.PathTracer(device, scene, (24, 16), seed=5) as tracer:
                return [{"radiance": tracer.render(samples=4)["radiance"].copy()}]
        with make_renderer(device, scene, (24, 16), seed=5, gbuffer="raster", **lighting) as renderer:
            return [snapshot(renderer.render()) for _ in range(3)]


def check_ways(lighting=None):
    for query, pipeline in zip(*(pictures_by(way, lighting) for way in ("query", "pipeline")), strict=True):
        assert query["radiance"].any()
        assert not [name for name in query if query[name].tobytes() != pipeline[name].tobytes()]


@pytest.mark.slow  # the driver compiles for minutes; tests/proofs/frame compares the two ways in a Cornell box
def test_paths_by_queries_and_pipelines_are_equal(any_device):
    check_ways()


@pytest.mark.slow
@each_lighting
def test_frames_by_queries_and_pipelines_are_equal(any_device, lighting):
    check_ways(lighting)
