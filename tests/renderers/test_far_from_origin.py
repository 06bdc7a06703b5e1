"""Scenes far from the origin have the pictures of the same scenes at the origin, whichever way they are traced."""

from __future__ import annotations

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.bound.projection import Projection
from solari_vk.scene import shapes

FAR = np.array((1e7, -3e6, 7e6))
SIZE = 24, 24
# Coordinates count from a place that is a multiple of 16 m, so that those here and there differ by roundings.
LEAST_EQUAL = 0.97


def lit_box(shift):
    """The Cornell box with a lamp of each kind that has a place, everything moved."""
    scene = sv.builtin("cornell_box")
    scene.add(sv.PointLight((0.3, 1.2, 0.3), intensity=1.0, radius=0.1, blocks_light=True))
    scene.add(sv.SpotLight((-0.3, 1.5, 0.2), direction=(0, -1, 0), intensity=2.0))
    scene.add(sv.Portal((0, 1, 1), (1, 0, 0), (0, 1, 0)))
    scene.add(sv.Environment(np.full((4, 8, 3), 0.2, np.float32)))
    for instance in scene.instances:
        instance.position = instance.position + shift
    for light in list(scene.lights)[:2]:
        light.position = light.position + shift
    scene.lights[2].center = scene.lights[2].center + shift
    scene.camera.transform = translated(scene.camera.transform, shift)
    return scene


def translated(transforms, shift):
    moved = np.array(transforms, np.float64)
    moved[..., :3, 3] += shift
    return moved


def check_equal(there, here):
    """Nearly all pixels are equal; rounding may move a few hits across an edge."""
    close = np.isclose(there, here, rtol=0.02, atol=1e-3)
    assert close.mean() > LEAST_EQUAL
    assert np.mean(there) == pytest.approx(np.mean(here), rel=0.02)


@pytest.fixture(scope="module")
def scenes():
    return lit_box(np.zeros(3)), lit_box(FAR)


def test_path_traced(device, scenes):
    pictures = []
    for scene in scenes:
        with sv.PathTracer(device, scene, SIZE) as renderer:
            frame = renderer.render(samples=4)
            pictures.append((frame["raw_radiance"], frame["depth"], frame["position"]))
    (here, depth, position), (there, far_depth, far_position) = pictures
    check_equal(there, here)
    check_equal(far_depth, depth)
    # Coordinates of the scene, as near as numbers of 32 bits are there.
    hit = np.isfinite(depth)
    np.testing.assert_allclose(far_position[hit], position[hit] + FAR, atol=1.0)


def test_realtime(device, scenes):
    pictures = []
    for scene in scenes:
        with sv.Renderer(device, scene, SIZE) as renderer:
            for _ in range(4):
                frame = renderer.render(scene.camera)
            pictures.append((np.mean(frame["raw_radiance"]), frame["albedo"]))
    (here, albedo), (there, far_albedo) = pictures
    assert there == pytest.approx(here, rel=0.05)
    check_equal(far_albedo, albedo)


def test_under_water(device):
    """A ball of few triangles, whose rays start above them, in a solid that absorbs light around the camera too."""
    traced, framed = [], []
    water = {"base_color": 1.0, "transmission": 1.0, "roughness": 0.0, "ior": 1.0, "solid": True}
    for shift in (np.zeros(3), FAR):
        scene = sv.Scene(sv.PointLight(np.add(shift, (2, 1.5, 2)), intensity=10.0))
        scene.add(shapes.sphere(segments=16), sv.Material(base_color=0.8))
        scene.add(
            shapes.box((-4, -3, -3), (4, 3, 5)),
            sv.Material(**water, attenuation_color=(0.5, 0.7, 0.9), attenuation_distance=1.0),
        )
        for instance in scene.instances:
            instance.position = shift
        scene.camera = sv.Camera.look_at(np.add(shift, (0, 0, 4)), shift, vertical_fov=0.5, ev100=0)
        with sv.PathTracer(device, scene, SIZE) as renderer:
            traced.append(renderer.render(samples=8)["raw_radiance"])
        for settings in ({}, {"restir": True}, {"lighting": "split"}):
            with sv.Renderer(device, scene, SIZE, sv.Settings(**settings)) as renderer:
                framed.append(np.mean([renderer.render()["raw_radiance"] for _ in range(8)], axis=(0, 1, 2)))
    check_equal(traced[1], traced[0])
    np.testing.assert_allclose(framed[3:], framed[:3], rtol=0.05)
    # and all that the path tracer sees
    np.testing.assert_allclose(framed[:3], [np.mean(traced[0], axis=(0, 1))] * 3, rtol=0.1)


def test_worlds_of_a_batch(device, scenes):
    """Worlds with transforms and lights of their own, beside each other and in a list of scenes."""
    found = []
    for shift in (np.zeros(3), FAR):
        scene = lit_box(shift)
        scene.remove(scene.lights[2])  # portals are the same in all worlds
        lamp = scene.lights[0]
        box = next(iter(scene.instances))
        with sv.Batch(device, scene, SIZE, 2, worlds=2, renderer="reference") as batch:
            batch.transforms[box] = translated([np.eye(4), np.eye(4)], [shift, shift + np.array((0, 0, -0.1))])
            batch.world_lights[lamp] = [lamp, None]
            found.append(batch.render([scene.camera] * 2, samples=4)["radiance"])
            poses = np.array([scene.camera.transform] * 2)
            by_array = batch.render(poses, vertical_fov=scene.camera.vertical_fov, samples=4)["radiance"]
            np.testing.assert_allclose(by_array, found[-1], rtol=1e-5)
    check_equal(found[1], found[0])
    with sv.Batch(device, list(scenes), SIZE, 2, outputs=("depth",)) as batch:
        here, there = batch.render([scene.camera for scene in scenes])["depth"]
    check_equal(there, here)


def test_rays_and_points(device, scenes):
    rng = np.random.default_rng(3)
    directions = rng.normal(size=(500, 3))
    hits = []
    lux = []
    for scene, shift in zip(scenes, (np.zeros(3), FAR), strict=True):
        with sv.RayTracer(device, scene) as tracer:
            hits.append(tracer.trace(np.array((0.1, 0.8, 0.1)) + shift, directions))
        lux.append(sv.illuminance(device, scene, np.array((0.1, 0.7, 0.8)) + shift, samples=256).lux)
    assert (hits[0].instance == hits[1].instance).mean() > LEAST_EQUAL
    met = (hits[0].instance >= 0) & (hits[1].instance >= 0)
    here, there = (found[met] for found in hits)
    check_equal(there.t, here.t)
    np.testing.assert_allclose(there.position, here.position + FAR, atol=1.0)
    assert lux[1] == pytest.approx(lux[0], rel=0.05)


def test_edited_light(device, scenes):
    """A lamp that is moved later is where it should be."""
    means = []
    for shift in (np.zeros(3), FAR):
        scene = lit_box(shift)
        with sv.PathTracer(device, scene, SIZE) as renderer:
            renderer.render(samples=1)
            scene.lights[0].position = shift + np.array((0.2, 0.6, 0.4))
            next(iter(scene.instances)).position = shift + np.array((0, 0, -0.2))
            means.append(renderer.render(samples=4)["raw_radiance"])
    check_equal(means[1], means[0])


def test_origin_is_assigned():
    scene = sv.builtin("cornell_box")
    assert not scene.origin.any()
    scene.origin = 1e6 + 0.1, 2, 3
    assert scene.origin.tolist() == [np.float32(1e6 + 0.1), 2, 3]
    with pytest.raises(sv.SolariError, match="origin"):
        scene.origin = float("nan"), 0, 0
    camera = sv.Camera.look_at((5, 6, 8), (1, 2, 3))
    moved = sv.Camera(transform=translated(camera.transform, (-4, -5, -6)))
    found = Projection.of(camera, (8, 8)).numbers_from([4.0, 5.0, 6.0])
    np.testing.assert_allclose(found, Projection.of(moved, (8, 8)).numbers, atol=1e-12)


def test_files_with_coordinates_of_a_country(tmp_path):
    """Vertices of text files, which may have more digits than numbers of 32 bits, keep their shape."""
    corners = np.add((4_512_345.25, 512_345.25, 100.5), [(0, 0, 0), (0.3, 0, 0), (0, 0.3, 0)])
    path = tmp_path / "parcel.obj"
    path.write_text("".join("v {:.3f} {:.3f} {:.3f}\n".format(*corner) for corner in corners) + "f 1 2 3\n")
    (instance,) = sv.load(path).instances
    found = instance.mesh.positions.astype(np.float64) @ instance.transform[:3, :3].T + instance.transform[:3, 3]
    np.testing.assert_allclose(np.sort(found, axis=0), np.sort(corners, axis=0), atol=1e-3)


def test_a_small_lamp_does_not_block_its_own_light(device):
    """4 km away, where coordinates still count from the scene's origin, its ball is rounded by a tenth of its size."""
    floors = []
    for blocks in (False, True):
        scene = sv.Scene(sv.PointLight((4000, 0.1, 0), intensity=1e-4, radius=0.005, blocks_light=blocks))
        scene.add(shapes.quad((4000, 0, 0), (0.4, 0, 0), (0, 0, -0.4)), sv.Material(base_color=0.6))
        scene.camera = sv.Camera.look_at((4000, 0.3, 0.4), (4000, -0.1, 0), vertical_fov=0.3, near=1e-3)
        with sv.PathTracer(device, scene, SIZE, max_bounces=1) as tracer:
            floors.append(tracer.render(samples=64)["radiance"].mean())
    assert floors[1] == pytest.approx(floors[0], rel=0.02)
