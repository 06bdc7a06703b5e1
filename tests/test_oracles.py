"""The references against each other and against known values, since a wrong reference proves nothing."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import brdf
from oracles.encodings import decode_octahedral, decode_rgb9e5, encode_rgb9e5, pcg_hash
from oracles.light import closed_box_radiance, polygon_irradiance, sun_irradiance
from oracles.rays import World, camera_rays, closest_by_brute_force
from scipy import stats
from support import statistics

from solari_vk.lab.embree import intersect_planes
from solari_vk.lab.measure.figures import interval
from solari_vk.scene import shapes
from solari_vk.scene.builtin import place
from solari_vk.scene.model import Camera, Instance, Material, Scene


def direction(cosine):
    return np.array((np.sqrt(1 - cosine**2), 0.0, cosine))


@pytest.mark.parametrize("roughness", [0.3, 1.0])
def test_albedo_by_visible_normals_is_the_hemisphere_integral(roughness):
    alpha = brdf.alpha_of(roughness)
    wi, solid = brdf.hemisphere_grid(600, 800)
    for cosine in (0.1, 0.6):
        a, b = brdf.directional_albedo_terms(alpha, cosine)
        for f0 in (0.0, 1.0):
            values = brdf.single_scattering(direction(cosine), wi, f0, alpha)[..., 0]
            assert (values * wi[..., 2] * solid).sum() == pytest.approx(f0 * a + b, abs=4e-4)


@pytest.mark.parametrize("metallic", [0.0, 0.5, 1.0])
def test_white_furnace_is_white_by_brute_force(metallic):
    wi, solid = brdf.hemisphere_grid(300, 400)
    for roughness, cosine in ((0.5, 0.8), (1.0, 0.15)):
        values = brdf.Surface(1.0, metallic, roughness, resolution=96).value(direction(cosine), wi)
        np.testing.assert_allclose((values * (wi[..., 2:] * solid[..., None])).sum(axis=(0, 1)), 1, atol=5e-4)


def test_diffuse_is_reciprocal():
    surface = brdf.Surface((0.3, 0.6, 0.9), 0.0, 0.5, resolution=96)
    wo, wi = direction(0.2), np.array((0.0, 0.8, 0.6))
    np.testing.assert_allclose(surface.diffuse(wo, wi), surface.diffuse(wi, wo))


def test_polygon_irradiance_is_the_integral():
    corners = np.array([(0.5, 2, -0.3), (0.5, 2, 0.7), (-0.5, 1.5, 0.7), (-0.5, 1.5, -0.3)])
    along, across = corners[1] - corners[0], corners[3] - corners[0]
    steps = (np.arange(400) + 0.5) / 400
    grid = (corners[0] + steps[:, None, None] * along + steps[None, :, None] * across).reshape(-1, 3)
    normal = np.cross(along, across)  # as long as the area
    for point in ((0.0, 0, 0.0), (3.0, 0, 1.0)):
        ray = grid - point
        brute = 5.0 * (ray[:, 1] * np.abs(ray @ normal) / (ray**2).sum(axis=1) ** 2).mean()
        assert polygon_irradiance(point, (0, 1, 0), corners, 5.0)[0] == pytest.approx(brute, rel=1e-5)


def test_small_sun_gives_its_illuminance():
    assert sun_irradiance(1000, 0.0093, 0.5) == pytest.approx(500, rel=1e-4)
    assert closed_box_radiance(2.0, 0.5, 3) == pytest.approx(2 * (1 - 0.5**4) / 0.5)


def test_encodings():
    # Known values: pcg's first output for seed 0, and the limits of the extension.
    assert pcg_hash(0) == 129708002
    assert encode_rgb9e5((1, 1, 1)) == 256 | 256 << 9 | 256 << 18 | 16 << 27
    limits = decode_rgb9e5(encode_rgb9e5((65408, 0, 1e9)))
    np.testing.assert_array_equal(limits, (65408, 0, 65408))
    random = np.random.default_rng(3)
    colors = random.random((200, 3)) * 10.0 ** random.uniform(-4, 4, (200, 1))
    error = np.abs(decode_rgb9e5(encode_rgb9e5(colors)) - colors)
    assert (error <= colors.max(axis=1, keepdims=True) / 512 + 2.0**-25).all()
    codes = np.array([32767 | 32767 << 16, 65534 | 32767 << 16, 32767 | 0 << 16, 0 | 0 << 16])
    np.testing.assert_array_equal(decode_octahedral(codes), [(0, 0, 1), (1, 0, 0), (0, -1, 0), (0, 0, -1)])


def test_embree_brute_force_and_camera_agree():
    scene = Scene(
        Instance(mesh=shapes.sphere(1.0, 8), material=Material(), transform=place((1, 2, -1), (0.3, 0, 0), 0.4)),
        Instance(mesh=shapes.box(), material=Material(), transform=place(1.0, (-1, 0, 0.5), 0.2)),
    )
    world = World(scene)
    camera = Camera.look_at((0, 1, 6), (0, 0, 0))
    origins, directions = (x.reshape(-1, 3) for x in camera_rays(camera, 40, 30))
    embree = world.embree_hits(origins, directions)
    brute, distance = closest_by_brute_force(world.corners, origins, directions)
    same = embree == brute
    assert same.mean() > 0.999
    assert 0.1 < (embree >= 0).mean() < 0.9
    found, _ = intersect_planes(world.corners, embree, origins, directions)
    np.testing.assert_allclose(found[same], distance[same], rtol=1e-9)
    hit = (embree >= 0) & same
    assert (np.einsum("ij,ij->i", world.normals[embree[hit]], directions[hit]) < 0).all(), "mirrored fronts"


def test_statistics_reject_what_is_wrong_and_only_that():
    random = np.random.default_rng(5)
    expected = np.full(1000, 40.0)
    assert statistics.chi_squared_p(random.poisson(expected), expected) > 0.001
    assert statistics.chi_squared_p(random.poisson(expected * np.linspace(0.8, 1.2, 1000)), expected) < 1e-6
    assert statistics.chi_squared_p([1, 10], [0, 11]) == 0
    np.testing.assert_array_equal(statistics.holm([0.001, 0.04, 0.03, 0.2], 0.05), [True, False, False, False])
    truth = np.ones((64, 64, 3))
    rejections = 0
    for _ in range(100):
        noisy = truth + random.normal(scale=0.1, size=truth.shape)
        result = statistics.compare(noisy, np.full(truth.shape, 0.01), truth, np.zeros(truth.shape))
        rejections += result.max_z > result.z_bar
    assert rejections <= 4
    biased = statistics.compare(1.02 * truth, np.full(truth.shape, 0.01), truth, np.zeros(truth.shape))
    with pytest.raises(AssertionError):
        statistics.assert_equal(biased, 0.003)
    runs = 1 + random.normal(scale=0.01, size=(16, 20))
    assert statistics.compare_runs(runs, np.ones(20), 0.005) == (0, True)
    assert statistics.compare_runs(runs * 1.02, np.ones(20), 0.005)[1] is False


def test_small_cells_are_pooled():
    assert statistics.chi_squared_p([2, 1, 9], [1, 3, 8]) == 1, "the small cells' sum is small: all are pooled"
    pooled = stats.chi2.sf(4**2 / 8 + 4**2 / 40, 1)
    assert statistics.chi_squared_p([4, 8, 36], [3, 5, 40]) == pytest.approx(pooled), "a small cell joins the next"


def test_interval_is_students():
    for count in (2, 3, 4, 9, 10, 41):
        values = np.arange(count) ** 2.0
        half_width = stats.t.ppf(0.975, count - 1) * values.std(ddof=1) / count**0.5
        assert interval(values) == pytest.approx((values.mean(), half_width))
    assert interval([7.0]) == (7.0, np.inf)
    assert interval([2.0] * 40) == (2.0, 0.0)
