"""Paths that start inside a solid that absorbs light: cameras, points of `illuminance` and rays of sensors in water, in
closed form; nested solids; frames, batches and worlds."""

from __future__ import annotations

import numpy as np
from support.frames import PATHS, PLAIN_PATHS, SPLIT_LIGHTING, make_renderer
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.scene import shapes

CLEAR = {"base_color": 1.0, "transmission": 1.0, "roughness": 0.0, "ior": 1.0, "solid": True}
COLOR = np.array((0.5, 0.25, 0.9))  # after a meter
INK = np.array((0.8, 0.3, 0.5))
DEPTH, ALBEDO = 1.0, 0.5


def solid(color):
    return sv.Material(**CLEAR, attenuation_color=color, attenuation_distance=1.0)


def water(walls=True):
    """A white sky over a gray floor below a meter of water, which is a box or, without walls, its surface alone."""
    scene = sv.Scene()
    scene.environment = sv.Environment((1.0, 1.0, 1.0))
    scene.add(shapes.quad((0, 0, 0), (900, 0, 0), (0, 0, -900)), sv.Material(base_color=ALBEDO, reflectance=0.0))
    surface = shapes.quad((0, DEPTH, 0), (1000, 0, 0), (0, 0, -1000))
    scene.add(shapes.box((-1000, -1, -1000), (1000, DEPTH, 1000)) if walls else surface, solid(COLOR))
    return scene


def arriving():
    """The irradiance on the floor over pi, by quadrature over the cosine."""
    cosine = (np.arange(20_000) + 0.5) / 20_000
    return np.mean(2 * cosine[:, None] * COLOR ** (DEPTH / cosine[:, None]), axis=0)


def looking_down(height):
    return sv.Camera.look_at((0, height, 0), (0, 0, -1e-3), vertical_fov=0.05, ev100=0)


def traced(device, scene, camera, samples=512, axis=(0, 1)):
    with sv.PathTracer(device, scene, (16, 16)) as tracer:
        return np.mean(tracer.render(camera, samples=samples)["raw_radiance"], axis=axis)


def mean_frame(device, scene, camera, frames, axis, **settings):
    with make_renderer(device, scene, (16, 16), **settings) as renderer:
        return np.mean([np.mean(renderer.render(camera)["raw_radiance"], axis=axis) for _ in range(frames)], axis=0)


def framed(device, scene, camera, frames=32, axis=(0, 1)):
    return mean_frame(device, scene, camera, frames, axis, passes=PATHS, **PLAIN_PATHS)


def reused(device, scene, camera, frames=32, axis=(0, 1)):
    return mean_frame(device, scene, camera, frames, axis, passes=PATHS, **PLAIN_PATHS, restir=True)


def split(device, scene, camera, frames=32, axis=(0, 1)):
    return mean_frame(device, scene, camera, frames, axis, **SPLIT_LIGHTING, jitter=False)


def check_cameras(device, ways=(traced, framed, reused, split)):
    """A camera in water sees the floor through the water between them, and the sky through that above it."""
    for way in ways:
        for walls in (True, False):
            scene = water(walls)
            for height in (0.5, 3.0):  # in the water, and above it
                expected = ALBEDO * arriving() * COLOR ** min(height, DEPTH)
                found = way(device, scene, looking_down(height)) / expected
                bar = 0.03 if way is traced else 0.05  # noise, and the 8 bits of a G-buffer's glass
                np.testing.assert_allclose(found, 1, rtol=bar, err_msg=f"{way.__name__}, {walls}, {height} m")
        up = sv.Camera.look_at((0, 0.5, 0), (0, 1, 1e-3), vertical_fov=0.05, ev100=0)
        np.testing.assert_allclose(way(device, water(), up), COLOR**0.5, rtol=0.01, err_msg=way.__name__)


def test_cameras(device):
    check_cameras(device)


def check_lamp(device, ways=(traced, framed, reused, split)):
    """A lamp and a camera in water, over its floor."""
    scene = water()
    scene.environment = None
    scene.add(sv.PointLight((0.4, 0.7, 0), intensity=10.0))
    away = np.hypot(0.4, 0.7)
    expected = ALBEDO / np.pi * 10 * 0.7 / away**3 * COLOR ** (away + 0.5)
    for way in ways:
        np.testing.assert_allclose(way(device, scene, looking_down(0.5)) / expected, 1, rtol=0.02, err_msg=way.__name__)


def test_lamp(device):
    check_lamp(device)


def check_shared_light(device, ways=(reused, split)):
    """Pixels near a lit wall and far from it share its light, which reaches each on its own way through the water."""
    gray = sv.Material(base_color=0.8, reflectance=0.0)
    scene = sv.Scene()
    scene.add(shapes.quad((0, 0, 0), (4, 0, 0), (0, 0, -4)), gray)
    scene.add(shapes.quad((0, 1, -1), (4, 0, 0), (0, 2, 0)), gray)
    scene.add(shapes.box((-3, -1, -3), (3, 3, 3)), solid((0.1, 0.3, 0.9)))
    scene.add(sv.SpotLight((0, 0.5, 0.3), direction=(0, 0.1, -1), intensity=100.0, outer_cone_angle=0.3))
    camera = sv.Camera.look_at((0, 2.5, -0.1), (0, 0, -0.2), vertical_fov=0.6, ev100=0)
    near, far = slice(3, 7), slice(9, 16)
    expected = traced(device, scene, camera, 4096, axis=1)
    for way in ways:
        found = way(device, scene, camera, frames=128, axis=1)
        for rows in (near, far):
            error = found[rows].mean(axis=0) / expected[rows].mean(axis=0) - 1
            print(way.__name__, rows, error)
            assert np.abs(error).max() < 0.15, f"{way.__name__}, {rows}: {error}"


def test_shared_light(device):
    check_shared_light(device)


def test_nested_solids(device):
    """A ball of ink in water, seen from its middle and from beside it; behind it there is water again."""
    scene = sv.Scene()
    scene.environment = sv.Environment((1.0, 1.0, 1.0))
    scene.add(shapes.box((-2, -2, -2), (2, 2, 2)), solid(COLOR))
    scene.add(shapes.box((-1, -1, -1), (1, 1, 1)), solid(INK))
    for z, expected in ((0, INK * COLOR), (1.5, INK**2 * COLOR**1.5), (3, INK**2 * COLOR**2)):
        camera = sv.Camera.look_at((0.1, 0.2, z), (0.1, 0.2, -9), vertical_fov=0.02, ev100=0)
        for way in (traced, framed, reused, split):
            found = way(device, scene, camera) / expected
            np.testing.assert_allclose(found.max() / found.min(), 1, rtol=0.005, err_msg=f"{way.__name__} {z}")
            bar = 0.03 if way is split else 0.02  # the 8 bits of a G-buffer's glass, for all colors alike
            np.testing.assert_allclose(found, 1, rtol=bar, err_msg=f"{way.__name__} {z}")


def test_illuminance(device):
    """On the floor, and a little above it."""
    found = sv.illuminance(device, water(), [(0, 0, 0), (0, 0.5, 0)], samples=1 << 15)
    cosine = (np.arange(20_000) + 0.5) / 20_000
    for lux, depth in zip(found.lux, (DEPTH, 0.5), strict=True):
        through = np.mean(2 * cosine[:, None] * COLOR ** (depth / cosine[:, None]), axis=0)
        assert abs(lux / (np.pi * through @ (0.2126, 0.7152, 0.0722)) - 1) < 0.02


def test_views_of_worlds(device):
    """Each view of a batch is in the solid of its own world."""
    cameras = [looking_down(0.5), looking_down(3.0)]
    for name, options in (("reference", {}), ("realtime", {"settings": sv.Settings(world_cache=False)})):
        with sv.Batch(device, [water(), water(False)], (8, 8), 4, renderer=name, **options) as batch:
            if name == "reference":
                found = [np.asarray(batch.render([*cameras, *cameras], samples=256)["radiance"])]
            else:
                found = [np.asarray(batch.render([*cameras, *cameras])["raw_radiance"]) for _ in range(16)]
        for index, height in enumerate((0.5, DEPTH, 0.5, DEPTH)):
            expected = ALBEDO * arriving() * COLOR**height
            seen = np.mean([views[index].reshape(-1, 3).mean(axis=0) for views in found], axis=0)
            np.testing.assert_allclose(seen, expected, rtol=0.15, err_msg=f"{name}, view {index}")


def test_sensors(device):
    """What comes back to a sensor in water has gone through it twice, and what passes the surface once."""
    rays = [(0, 0.5, 0), (0, 3, 0), (0, 0.5, 0)], [(0, -2, 0), (0, -1, 0), (0, 1, 0)]
    scene = water()
    with sv.RayTracer(device, scene) as tracer:
        hits, echoes = tracer.backscatter(*rays)
        scene.remove(scene.instances[1])
        in_air = tracer.backscatter(*rays)[1].backscatter[0]
        np.testing.assert_allclose(hits.t, (0.25, 2, 0.5), rtol=1e-6)
        np.testing.assert_allclose(echoes.backscatter[0], in_air * COLOR, rtol=1e-3)
        np.testing.assert_allclose(echoes.passed[1], 1, rtol=1e-3)
        np.testing.assert_allclose(echoes.passed[2], COLOR**0.5, rtol=1e-3)


WALK = "scene/walk.glsl"
test_a_seeded_bug_is_noticed = bug_tests(
    {
        "a camera in air": (
            lambda device: check_cameras(device, (traced,)),
            Bug(WALK, "find_medium", "return NO_MEDIUM;"),
        ),
        "reuse in air": (
            lambda device: check_lamp(device, (reused,)),
            Bug("passes/paths/vertex.glsl", "medium_towards", "return NO_MEDIUM;"),
        ),
        "lit through the water of another pixel": (
            lambda device: check_shared_light(device, (split,)),
            Bug(
                "passes/solari019/restir_gi/reservoir.glsl",
                "gi_radiance",
                "return correct(surface, reservoir) / transmittance(camera_medium(), 0.5);",
            ),
        ),
        "air around every solid": (
            test_nested_solids,
            Bug(
                WALK,
                "medium_below",
                "Medium found = correct(instance, material, medium); found.around = NO_INDEX; return found;",
            ),
        ),
    },
    quick=("a camera in air",),
)
