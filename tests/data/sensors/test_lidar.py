"""Lidars against closed forms: distances, strengths, glass, beams at edges, detection, motion; and Embree's hits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from oracles.rays import World
from scipy import stats
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.scene import shapes

PLAIN = {"elevations": (-0.3, 0.0, 0.25), "azimuth_steps": 90, "max_range": 200.0}


def matte(color, **fields):
    """A surface that is Lambertian."""
    return sv.Material(base_color=color, specular=0.0, roughness=1.0, **fields)


def wall(distance, material, half=200.0):
    """A wall across -z."""
    return sv.Instance(shapes.quad((0, 0, -distance), (half, 0, 0), (0, half, 0)), material)


def scan(device, scene, lidar, pose=(0, 0, 0), **options):
    with sv.RayTracer(device, scene) as tracer:
        return lidar.scan(tracer, pose, **options)


def test_a_wall(device):
    """Distances and strengths of a gray wall: the reflectivity times the cosine, whatever the distance."""
    for distance in (2.0, 20.0):
        lidar = sv.Lidar(**PLAIN)
        found = scan(device, sv.Scene(wall(distance, matte((0.4, 0.9, 0.9)))), lidar)
        cosine = -lidar.directions[..., 2]
        expected = np.where(cosine > 0, distance / np.where(cosine > 0, cosine, 1), np.inf)
        seen = expected < 100
        np.testing.assert_allclose(found.distance[..., 0][seen], expected[seen], rtol=1e-5)
        np.testing.assert_allclose(found.intensity[..., 0][seen], 0.4 * cosine[seen], rtol=1e-3)
        assert np.isnan(found.distance[..., 0][expected > 200]).all()
        np.testing.assert_allclose(found.position[..., 0, 2][seen], -distance, rtol=1e-5)
        np.testing.assert_allclose(found.raw_position[..., 0, :][seen], found.position[..., 0, :][seen], rtol=1e-5)


def test_hits_are_embrees(device):
    """Random triangles all around a sensor that is turned and moved; frame and turning direction too."""
    rng = np.random.default_rng(4)
    corners = rng.normal(0, 6, (400, 1, 3)) + rng.normal(0, 1.5, (400, 3, 3))
    scene = sv.Scene(sv.Instance(sv.Mesh(positions=corners.reshape(-1, 3).astype(np.float32)), matte(0.5)))
    lidar = sv.Lidar.preset(
        "OS1-64", azimuth_steps=256, range_noise=0.0, range_resolution=0.0, reference=(0, 0), min_range=0.0
    )
    pose = np.eye(4)
    pose[:3, :3] = sv.Camera(rotation=0.7).rotation
    pose[:3, 3] = (0.5, -0.2, 0.3)
    found = scan(device, scene, lidar, pose).distance[..., 0].ravel()
    elevation, azimuth = np.meshgrid(lidar.elevations, np.arange(256) / 256 * math.tau, indexing="ij")
    local = np.stack([np.cos(elevation) * np.sin(azimuth), np.sin(elevation), -np.cos(elevation) * np.cos(azimuth)], -1)
    along = (local @ pose[:3, :3].T).reshape(-1, 3)
    world = World(scene)
    index = world.embree_hits(np.broadcast_to(pose[:3, 3], along.shape), along)
    assert np.mean((index >= 0) == np.isfinite(found)) > 0.999
    both = (index >= 0) & np.isfinite(found)
    assert both.mean() > 0.2
    a = world.corners[index[both], 0]
    normal = world.normals[index[both]]
    expected = np.einsum("ni,ni->n", a - pose[:3, 3], normal) / np.einsum("ni,ni->n", along[both], normal)
    assert np.mean(np.abs(found[both] - expected) < 1e-3 * expected) > 0.999


def test_returns_through_panes(device):
    """A blended pane, 3 m before a wall, sends back alpha of its light, and lets (1 - alpha)² through and back; glass
    lets its own share pass."""
    lidar = sv.Lidar(elevations=(0.0,), azimuth_steps=1, returns=3, max_range=50.0)
    blended = sv.Scene(wall(4, matte(0.6, alpha=0.25, alpha_mode="blend")), wall(7, matte(0.8)))
    found = scan(device, blended, lidar)
    np.testing.assert_allclose(found.distance[0, 0], (4, 7, np.nan), rtol=1e-5)
    np.testing.assert_allclose(found.intensity[0, 0], (0.25 * 0.6, 0.75**2 * 0.8, 0), rtol=1e-3)
    assert found.instance[0, 0, 2] == -1
    assert found.instance[0, 0, 0] != found.instance[0, 0, 1]
    pane = sv.Material(transmission=1.0, roughness=0.0, base_color=1.0)
    solid = shapes.box((-50, -50, -4.02), (50, 50, -4))
    glass = sv.Material(transmission=1.0, roughness=0.0, base_color=1.0, solid=True)
    thin, thick = (1 - 0.04) ** 2, (1 - 0.04) ** 4  # there and back, past one boundary and past two
    for thing, expected in ((wall(4, pane), thin), (sv.Instance(solid, glass), thick)):
        found = scan(device, sv.Scene(thing, wall(7, matte(0.8))), lidar)
        np.testing.assert_allclose(found.distance[0, 0], (7, np.nan, np.nan), rtol=1e-5)
        assert found.intensity[0, 0, 0] / 0.8 == pytest.approx(expected, abs=1e-3)


def test_returns_are_limited_to_the_strongest(device):
    lidar = sv.Lidar(elevations=(0.0,), azimuth_steps=1, returns=1)
    weak = sv.Scene(wall(4, matte(0.1, alpha=0.2, alpha_mode="blend")), wall(7, matte(0.9)))
    assert scan(device, weak, lidar).distance[0, 0].tolist() == pytest.approx([7])
    close = sv.Scene(wall(4, matte(0.5, alpha=0.5, alpha_mode="blend")), wall(4.2, matte(1.0)))
    both = scan(device, close, sv.Lidar(elevations=(0.0,), azimuth_steps=1, returns=2, separation=0.5))
    powers = np.array((0.25 / 16, 0.25 / 4.2**2))
    assert both.distance[0, 0, 0] == pytest.approx((powers @ (4, 4.2)) / powers.sum(), rel=1e-4)
    assert np.isnan(both.distance[0, 0, 1])


def test_a_beam_meets_two_surfaces_at_an_edge(device):
    """A wide beam straight at the edge of a near wall has a return of each half; a narrow one has one of them."""
    near = sv.Instance(shapes.quad((-5, 0, -10), (5, 0, 0), (0, 5, 0)), matte(0.5))
    scene = sv.Scene(near, wall(20, matte(0.5)))
    wide = sv.Lidar(elevations=(0.0,), azimuth_steps=1, returns=2, divergence=0.003, rays_per_beam=64)
    found = scan(device, scene, wide)
    np.testing.assert_allclose(found.distance[0, 0], (10, 20), rtol=1e-3)
    np.testing.assert_allclose(found.intensity[0, 0], 0.25, rtol=0.05)
    assert np.isfinite(scan(device, scene, sv.Lidar(elevations=(0.0,), azimuth_steps=1, returns=2)).distance).sum() == 1


def test_detection_falls_with_the_distance(device):
    """Nine of ten at the reference, by the normal distribution elsewhere; without noise all or none."""
    reference = (40.0, 0.1)
    for distance in (36.0, 40.0, 44.0):
        lidar = sv.Lidar(elevations=(0.0,) * 4000, azimuth_steps=1, reference=reference)
        scene = sv.Scene(wall(distance, matte(0.1)))
        found = np.isfinite(scan(device, scene, lidar, seed=5).distance).mean()
        threshold, sigma = 1 / (1 + 1.2815516 / 6), 1 / (6 + 1.2815516)
        expected = stats.norm.cdf(((40 / distance) ** 2 - threshold) / sigma)
        assert found == pytest.approx(expected, abs=4 * math.sqrt(0.25 / 4000))
        certain = np.isfinite(scan(device, scene, lidar, noise=False).distance)
        assert certain.all() == certain.any() == ((40 / distance) ** 2 > threshold)


def test_the_noise_of_intensity(device):
    """The receiver's noise is in the intensity, and decides which of two equal echoes is the strongest."""
    lidar = sv.Lidar(elevations=(0.0,) * 4000, azimuth_steps=1, reference=(40.0, 0.1))
    found = scan(device, sv.Scene(wall(20, matte(0.1))), lidar, seed=5).intensity
    assert found.mean() == pytest.approx(0.1, rel=0.01)
    assert found.std() == pytest.approx(20**2 * 0.1 / 40**2 / (6 + 1.2815516), rel=0.05)
    equal = sv.Scene(wall(10, matte(0.1, alpha=0.5, alpha_mode="blend")), wall(20, matte(0.8)))
    first = scan(device, equal, lidar, seed=5).distance < 15
    assert first.mean() == pytest.approx(0.5, abs=0.05)


def test_noise_and_resolution_of_distances(device):
    lidar = sv.Lidar(elevations=(0.0,) * 4000, azimuth_steps=1, range_noise=0.03, range_resolution=0.002)
    scene = sv.Scene(wall(12, matte(0.5)))
    found, again = (scan(device, scene, lidar, seed=2).distance.ravel() for _ in range(2))
    np.testing.assert_array_equal(found, again)
    assert found.mean() == pytest.approx(12, abs=4 * 0.03 / math.sqrt(4000))
    assert found.std() == pytest.approx(0.03, rel=0.05)
    np.testing.assert_allclose(found / 0.002, np.round(found / 0.002), atol=1e-6)


def test_a_sensor_that_moves_during_the_scan(device):
    """At 20 m/s towards a wall each column is nearer; points lie on the wall, and raw ones don't."""
    lidar = sv.Lidar(elevations=(0.0,), azimuth_steps=64, azimuths=(-0.5, 0.5), period=0.1)
    scene = sv.Scene(wall(30, matte(0.5)))

    def pose(time):
        return (0, 0, -20 * time)

    with sv.RayTracer(device, scene) as tracer:
        found = lidar.scan(tracer, pose)
        same = lidar.scan(tracer, [np.eye(4) + np.outer((0, 0, -20 * t, 0), (0, 0, 0, 1)) for t in lidar.column_times])
    expected = (30 - 20 * lidar.column_times) / np.cos(lidar.column_azimuths)
    np.testing.assert_allclose(found.distance[0, :, 0], expected, rtol=1e-5)
    np.testing.assert_allclose(found.position[0, :, 0, 2], -30, rtol=1e-5)
    assert np.ptp(found.raw_position[0, :, 0, 2]) == pytest.approx(20 * 0.1 * 63 / 64, rel=1e-3)
    np.testing.assert_array_equal(found.distance, same.distance)


@pytest.mark.slow
def test_a_million_rays_in_one_call(device):
    lidar = sv.Lidar.preset("OS1-128", rays_per_beam=4)
    found = scan(device, sv.builtin("cornell_box"), lidar, (1, 1, 0.5))
    assert found.distance.size * 4 > 1_000_000
    assert np.isfinite(found.distance).mean() > 0.5


def test_files_of_points(device, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    found = scan(device, sv.Scene(wall(5, matte(0.5), half=3.0)), sv.Lidar(**PLAIN))
    points = found.points
    assert 0 < len(points) < 3 * 90
    found.save(tmp_path / "cloud.ply")
    cloud = trimesh.load(tmp_path / "cloud.ply")
    expected = np.stack([points["x"], points["y"], points["z"]], -1)
    np.testing.assert_array_equal(expected, found.position[np.isfinite(found.distance)])  # far from the origin too
    np.testing.assert_allclose(cloud.vertices, expected)
    data = cloud.metadata["_ply_raw"]["vertex"]["data"]
    for name in ("intensity", "channel", "instance"):
        np.testing.assert_array_equal(np.ravel(data[name]), points[name])
    found.save(tmp_path / "cloud.npy")
    np.testing.assert_array_equal(np.load(tmp_path / "cloud.npy"), points)
    with pytest.raises(SolariError, match=r"written as .ply or .npy, not '.las'"):
        found.save(tmp_path / "cloud.las")


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"elevations": (-15, 15)}, r"between -pi/2 and pi/2 radians.*np.radians"),
        ({"elevations": (math.nan,)}, "elevations must be finite"),
        ({"azimuth_steps": 0}, "azimuth_steps must be a whole number from 1 on, not 0"),
        ({"min_range": 300.0}, "must be below max_range"),
        ({"reference": (40.0, 0.0)}, "a distance and a reflectivity above 0"),
        ({"range_noise": -1}, "range_noise is a number between 0 and 1000 m"),
    ],
)
def test_what_is_no_lidar(fields, message):
    with pytest.raises(SolariError, match=message):
        sv.Lidar(**{**PLAIN, **fields})


def test_wrong_poses(device):
    with pytest.raises(SolariError, match="Lidar has no preset 'VLP-17'; did you mean 'VLP-16'"):
        sv.Lidar.preset("VLP-17")
    with sv.RayTracer(device, sv.Scene()) as tracer:
        with pytest.raises(SolariError, match="one for each of 90 columns, not 7"):
            sv.Lidar(**PLAIN).scan(tracer, [np.eye(4)] * 7)
        with pytest.raises(SolariError, match="scan: seed must be a whole number from 0 on, not True"):
            sv.Lidar(**PLAIN).scan(tracer, (0, 0, 0), seed=True)
        with pytest.raises(SolariError, match="poses must be finite"):
            sv.Lidar(**PLAIN).scan(tracer, (0, math.nan, 0))
        assert np.isnan(sv.Lidar(**PLAIN).scan(tracer, (0, 0, 0)).distance).all()
    with pytest.raises(SolariError, match=r"a solari_vk.RayTracer is needed"):
        sv.Lidar(**PLAIN).scan(None, (0, 0, 0))


test_a_seeded_bug_is_noticed = bug_tests(
    {
        "an echo without the cosine": (
            test_a_wall,
            Bug(
                "passes/ray_tracer/backscatter.glsl",
                "find_echo",
                "Echo echo = correct(hit, origin, way); echo.backscatter = vec3(0.4 / PI); return echo;",
            ),
        ),
        "panes that keep all light": (
            test_returns_through_panes,
            Bug(
                "passes/ray_tracer/backscatter.glsl",
                "find_echo",
                "Echo echo = correct(hit, origin, way); echo.passed = vec3(0.0); return echo;",
            ),
        ),
    }
)
