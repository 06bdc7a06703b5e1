"""What is small is lit as well on a ground that reaches far: origins of rays, positions, points of `illuminance`."""

from __future__ import annotations

import numpy as np
import pytest
from support.frames import PATHS, PLAIN_PATHS, make_renderer
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.matrices import rotation

CUBE, GRAY = 0.02, sv.Material(base_color=0.5, reflectance=0)
TILT = np.eye(4)
TILT[:3, :3] = rotation(np.array((1.0, 0.3, 0.2)), 0.7)
GROUNDS = {  # half the size of the quad, its transform, and that of the whole scene
    "a large quad": (1e5, np.eye(4), np.eye(4)),
    "a scaled quad": (1.0, np.diag((1e5, 1e5, 1e5, 1)), np.eye(4)),
    "a stretched quad": (1.0, np.diag((1e5, 1, 1e5, 1)), np.eye(4)),
    "a scaled quad on a slope": (1.0, np.diag((1e5, 1e5, 1e5, 1)), TILT),
}
SMALL = (10.0, np.eye(4), np.eye(4))


def place(half, ground, turn):
    """A cube of 2 cm on a ground, in the sun, and a camera that sees its shadow."""
    scene = sv.Scene()
    scene.add(shapes.quad((0, 0, 0), (half, 0, 0), (0, 0, -half)), GRAY, transform=turn @ ground)
    scene.add(shapes.box((-CUBE / 2, 0, -CUBE / 2), (CUBE / 2, CUBE, CUBE / 2)), GRAY, transform=turn)
    scene.environment = sv.Environment((1.0, 1.0, 1.0))
    axes = turn[:3, :3]
    scene.add(sv.DirectionalLight(axes @ (-1, -1, 0), illuminance=3.0))
    eye, target = axes @ (-CUBE, 7.5 * CUBE, 0), axes @ (-CUBE, 0, -CUBE / 200)
    scene.camera = sv.Camera.look_at(eye, target, vertical_fov=0.1, ev100=0, near=1e-3)
    return scene


def traced(device, scene):
    with sv.PathTracer(device, scene, (8, 8)) as tracer:
        return float(np.mean(tracer.render(samples=256)["raw_radiance"]))


def framed(device, scene):
    with make_renderer(device, scene, (8, 8), passes=PATHS, gbuffer="traced", **PLAIN_PATHS) as renderer:
        return float(np.mean([np.mean(renderer.render()["raw_radiance"]) for _ in range(64)]))


def check_shadows(device, ways=(traced, framed), names=tuple(GROUNDS)):
    expected = traced(device, place(*SMALL))
    for name in names:
        for way in ways:
            found = way(device, place(*GROUNDS[name])) / expected
            assert abs(found - 1) < 0.04, f"{name}, {way.__name__}: {found:.3f}"


def test_shadows(device):
    check_shadows(device)


def test_a_vast_ground_has_no_holes(device):
    """Lavapipe's rasterizer loses a tenth of its pixels from nearby."""
    scene = sv.Scene(sv.Camera.look_at((0.4, 0.4, 0.5), (0, 0, 0), fov=40))
    scene.add(shapes.quad((0, 0, 0), (1e6, 0, 0), (0, 0, -1e6)), sv.Material(unlit=True))
    with make_renderer(device, scene, (48, 48), passes=PATHS) as renderer:
        assert (renderer.render()["raw_radiance"] > 0).all()


@pytest.mark.parametrize("name", GROUNDS)
def test_positions(device, name):
    """Rays meet the ground where they should, though barycentrics, and drivers' distances, have a step of a centimeter
    there."""
    half, ground, turn = GROUNDS[name]
    axes, scene = turn[:3, :3], place(half, ground, turn)
    rng = np.random.default_rng(3)
    points = rng.uniform(-0.1, 0.1, (400, 3)) * (1, 0, 1) + np.array((0.2, 0, 0))
    back = rng.uniform((0, 0.05, -0.1), (0.3, 0.1, 0.1), (400, 3))  # rather flat, for which drivers are least exact
    with sv.RayTracer(device, scene) as tracer:
        hits = tracer.trace((points + back) @ axes.T, -back @ axes.T)
    assert np.abs(hits.position - points @ axes.T).max() < 1e-6


def check_illuminance(device):
    """A point beside the cube is in its shadow."""
    points, normal = [(-0.015, 0, 0), (-0.3, 0, 0)], (0, 1, 0)
    expected = sv.illuminance(device, place(*SMALL), points, normal, samples=4096).lux
    for name, (half, ground, turn) in GROUNDS.items():
        at = np.asarray(points) @ turn[:3, :3].T
        found = sv.illuminance(device, place(half, ground, turn), at, turn[:3, :3] @ normal, samples=4096).lux
        np.testing.assert_allclose(found, expected, rtol=0.04, err_msg=name)


def test_illuminance(device):
    check_illuminance(device)


@pytest.mark.parametrize("slope", [0.0, 1e-6, 1e-3])
def test_rays_leave_what_slopes_a_little(device, slope):
    """Rays that met the floor which they leave would find the sun below it: the upper side is black."""
    scene = sv.Scene()
    scene.add(shapes.quad((0.3, 0, 0.2), (4, 4 * slope, 0), (0, 3 * slope, -4)), sv.Material(base_color=1.0))
    scene.add(sv.DirectionalLight((0.2, 1, 0.3), illuminance=1e5))
    camera = sv.Camera.look_at((0.5, 1.7, 1), (0, 0, -1), fov=90)
    with sv.PathTracer(device, scene, (64, 32), max_bounces=2) as tracer:
        assert not tracer.render(camera, samples=64)["radiance"].any()


SURFACE = "scene/surface.glsl"
test_a_seeded_bug_is_noticed = bug_tests(
    {
        "offsets by the largest extent": (
            lambda device: check_shadows(device, (traced,), ("a large quad",)),
            Bug(
                SURFACE,
                "world_ray_offset",
                "return correct(vec3(max_component(reach)), object_position, world_from_object, cofactors,"
                " object_normal);",
            ),
        ),
        "positions by barycentrics": (
            lambda device: test_positions(device, "a large quad"),
            Bug(SURFACE, "position_on_ray", "return position;"),
        ),
    },
    quick=("positions by barycentrics",),
)
