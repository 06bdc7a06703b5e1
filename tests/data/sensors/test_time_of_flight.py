"""Time-of-flight cameras against closed forms: distances, noise, ambiguity, missing returns, and mixed pixels."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.scene import shapes

SIZE = (48, 36)
C = 299792458.0


def wall(distance, color=0.5, half=100.0, **fields):
    material = sv.Material(base_color=color, specular=0.0, roughness=1.0, **fields)
    return sv.Instance(shapes.quad((0, 0, -distance), (half, 0, 0), (0, half, 0)), material)


def capture(device, scene, tof, camera=None, size=SIZE, **options):
    with sv.RayTracer(device, scene) as tracer:
        return tof.capture(tracer, camera or sv.Camera(), size, **options)


@pytest.mark.parametrize("projection", ["perspective", "fisheye"])
def test_depths(device, projection):
    """Without noise the depth is the renderer's, for lenses too, and light falls with the squared distance."""
    camera = sv.Camera(projection=projection, vertical_fov=1.5)
    scene = sv.Scene(wall(3.0))
    found = capture(device, scene, sv.TimeOfFlightCamera(min_amplitude=0.0), camera, noise=False)
    with sv.PathTracer(device, scene, SIZE) as tracer:
        expected = tracer.render(camera, samples=1)["depth"]
    seen = np.isfinite(found.depth)
    near = expected < 7
    np.testing.assert_array_equal(seen[near], True)
    np.testing.assert_allclose(found.depth[near], expected[near], rtol=1e-4)
    cosine = 3.0 / found.distance[near]
    np.testing.assert_allclose(found.amplitude[near], 0.8 * 5e4 * 0.5 * cosine / found.distance[near] ** 2, rtol=2e-3)


def test_the_noise_of_distances(device):
    """c / (4 sqrt(2) pi f) * sqrt(B) / A."""
    tof = sv.TimeOfFlightCamera(signal=20_000, background=5_000)
    camera = sv.Camera(vertical_fov=0.02)
    found = capture(device, sv.Scene(wall(2.0)), tof, camera, (96, 96), seed=1)
    signal = 20_000 * 0.5 / 4
    expected = C / (4 * math.sqrt(2) * math.pi * 20e6) * math.sqrt(signal + 5_000) / (0.8 * signal)
    assert found.distance.std() == pytest.approx(expected, rel=0.04)
    assert found.distance.mean() == pytest.approx(2.0, abs=5 * expected / 96)
    again = capture(device, sv.Scene(wall(2.0)), tof, camera, (96, 96), seed=1)
    np.testing.assert_array_equal(found.distance, again.distance)


def test_ambiguity_and_a_second_frequency(device):
    scene, camera = sv.Scene(wall(9.0)), sv.Camera(vertical_fov=0.02)
    one = sv.TimeOfFlightCamera(frequencies=(20e6,))
    assert one.unambiguous_range == pytest.approx(C / 40e6)
    assert sv.TimeOfFlightCamera(frequencies=(100e6, 80e6)).farthest == pytest.approx(C / 40e6)
    np.testing.assert_allclose(capture(device, scene, one, camera, noise=False).distance, 9 - C / 40e6, atol=2e-3)
    two = sv.TimeOfFlightCamera(frequencies=(100e6, 80e6), max_range=7.4)
    nearer = sv.Scene(wall(6.2))
    np.testing.assert_allclose(capture(device, nearer, two, camera, seed=1).distance, 6.2, atol=0.1)
    three = sv.TimeOfFlightCamera(frequencies=(100e6, 80e6, 16e6), max_range=9.3, signal=500_000)
    np.testing.assert_allclose(capture(device, scene, three, camera, seed=1).distance, 9, atol=0.1)


def test_transparent_surfaces_do_not_count(device):
    """Ten panes of glass without refraction, which is invisible, stand before a wall; a pane that is seen counts."""
    camera, tof = sv.Camera(vertical_fov=0.02), sv.TimeOfFlightCamera(max_surfaces=1)
    clear = sv.Material(transmission=1.0, roughness=0.0, base_color=1.0, ior=1.0)
    panes = [sv.Instance(wall(1 + 0.1 * number).mesh, clear) for number in range(10)]
    found = capture(device, sv.Scene(*panes, wall(3.0)), tof, camera, noise=False)
    np.testing.assert_allclose(found.distance, 3, rtol=1e-3)
    np.testing.assert_allclose(found.amplitude, 0.8 * 5e4 * 0.5 / 9, rtol=2e-3)
    seen = capture(
        device, sv.Scene(*panes, wall(2.5, alpha=0.5, alpha_mode="blend"), wall(3.0)), tof, camera, noise=False
    )
    np.testing.assert_allclose(seen.distance, 2.5, rtol=1e-3)


def test_missing_returns(device):
    """Too faint, too near, too bright."""
    tof = sv.TimeOfFlightCamera(min_range=0.5, full_well=60_000, max_range=6.0)
    missing = (3.0, 1e-4), (0.4, 0.1), (0.6, 1.0), (7.0, 1.0)
    for distance, color, there in ((3.0, 0.5, True), *((*case, False) for case in missing)):
        found = capture(device, sv.Scene(wall(distance, color)), tof, sv.Camera(vertical_fov=0.02))
        assert np.isfinite(found.depth).all() == np.isfinite(found.depth).any() == there, distance
    assert not np.isfinite(capture(device, sv.Scene(), tof).depth).any()
    faint = sv.TimeOfFlightCamera(signal=0)
    assert np.isfinite(capture(device, sv.Scene(wall(3.0)), faint).depth).mean() < 1e-3  # noise alone


def test_mixed_pixels(device):
    """Half of a pixel's light from each of two walls: the phase of the sum of both, between them. A blended pane
    mixes too."""
    camera, tof = sv.Camera(vertical_fov=0.02), sv.TimeOfFlightCamera(rays_per_pixel=4)
    half = sv.Instance(shapes.quad((-5, 0, -2), (5, 0, 0), (0, 5, 0)), wall(2).material)
    found = capture(device, sv.Scene(half, wall(3.0)), tof, camera, (3, 3), noise=False)
    pane = sv.Scene(wall(2.0, 0.5, alpha=0.5, alpha_mode="blend"), wall(3.0, 0.5))
    through = capture(device, pane, sv.TimeOfFlightCamera(), camera, (3, 3), noise=False)
    for distance, (near, far) in ((found.distance[1, 1], (0.5, 0.5)), (through.distance[1, 1], (0.5, 0.25))):
        wave = sum(part / d**2 * cmath.exp(1j * 4 * math.pi * 20e6 * d / C) for part, d in ((near, 2.0), (far, 3.0)))
        assert distance == pytest.approx(cmath.phase(wave) * C / (4 * math.pi * 20e6), rel=1e-3)
    assert found.distance[1, 0] == pytest.approx(2.0, rel=1e-3)
    assert found.distance[1, 2] == pytest.approx(3.0, rel=1e-3)


def test_what_is_no_camera(device):
    for fields, message in (
        ({"frequencies": ()}, "frequencies are whole numbers"),
        ({"contrast": 0}, "contrast is a number between"),
        ({"max_range": 10.0}, "10 m, is beyond the unambiguous range of these frequencies, 7.49481 m: add a frequency"),
        ({"frequencies": (100e6, 80e6), "max_range": 8}, r"8 m, is beyond the unambiguous range .*, 7.49481 m"),
        ({"frequencies": (20e6, 20e6)}, "frequencies must differ"),
        ({"frequencies": (100e6, 99999999)}, r"up to 1.49896e.08 m 1e.08 Hz have more than 10,000 turns"),
        ({"rays_per_pixel": 1.5}, r"rays_per_pixel must be a whole number from 1 to 64, not 1.5"),
    ):
        with pytest.raises(SolariError, match=message):
            sv.TimeOfFlightCamera(**fields)
    with pytest.raises(SolariError, match=r"capture: seed must be a whole number from 0 on, not 0.5"):
        capture(device, sv.Scene(), sv.TimeOfFlightCamera(), seed=0.5)
    with pytest.raises(SolariError, match="sends no light out of one point"):
        capture(device, sv.Scene(), sv.TimeOfFlightCamera(), sv.Camera(orthographic_height=2))


test_a_seeded_bug_is_noticed = bug_tests(
    {
        "an echo without the cosine": (
            lambda device: test_depths(device, "perspective"),
            Bug(
                "passes/ray_tracer/backscatter.glsl",
                "find_echo",
                "Echo echo = correct(hit, origin, way); echo.backscatter = vec3(0.5 / PI); return echo;",
            ),
        )
    }
)
