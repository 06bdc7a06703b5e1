"""Lenses in pictures: pixels show what numpy's rays meet, motion follows, and a fisheye's picture is a panorama's."""

from __future__ import annotations

import math

import numpy as np
import pytest
from oracles.encodings import decode_gbuffer
from support.frames import GBUFFER, make_renderer, path_traced
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, matte, place

SIZE = (64, 48)
K = ((30.0, 0, 33.0), (0, 28.0, 22.0), (0, 0, 1))
POSE = np.diag((1.0, -1.0, -1.0)), (0.1, -0.2, 0.0)
LENSES = {
    "offset": lambda: sv.Camera.from_opencv(K, *POSE, SIZE),
    "brown_conrady": lambda: sv.Camera.from_opencv(K, *POSE, SIZE, (-0.12, 0.02, 0.004, -0.003, 0.001)),
    "kannala_brandt": lambda: sv.Camera.from_opencv(
        ((14.0, 0, 33), (0, 15.0, 22), (0, 0, 1)), *POSE, SIZE, (0.03, -0.006, 0.001, 1e-5), projection="fisheye"
    ),
    "circle": lambda: sv.Camera(projection="fisheye", vertical_fov=math.pi, image_circle=math.pi),
    "stereographic": lambda: sv.Camera(projection="stereographic", vertical_fov=4.5),
    "equirectangular": lambda: sv.Camera(projection="equirectangular"),
    "stereo": lambda: sv.Camera(projection="equirectangular", eye_offset=0.2),
    "cube": lambda: sv.Camera(projection="cube"),
}
PIXELS = np.stack(np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1])), -1)


def room(name="equirectangular"):
    """A closed room with a lamp and small spheres all around the camera, which is the scene's."""
    scene = sv.Scene(sv.Instance(shapes.box((-3, -2, -3), (3, 2, 3), inward=True), matte((0.7, 0.5, 0.3))))
    scene.add(sv.Instance(shapes.box((-1, 1.8, -1), (1, 1.9, 1)), lamp(6.0)))
    for x, y, z in ((0.3, 0.2, -2), (1.5, -0.4, -1), (-1.6, 0.3, 0.4), (0.5, -0.5, 1.8), (-0.4, -1.5, -0.6)):
        scene.add(sv.Instance(shapes.sphere(0.15, 16), matte((0.2, 0.4, 0.8)), transform=place(1.0, (x, y, z))))
    scene.add(LENSES[name]())
    return scene


@pytest.mark.parametrize("name", LENSES)
def test_pixels_show_what_their_rays_meet(device, name):
    """Points that pixels show are projected to the pixels' centers, depths lead to them, and spheres are where their
    centers are projected; the circle around which a lens sees nothing is empty."""
    scene = room(name)
    camera = scene.camera
    with make_renderer(device, scene, SIZE, passes=GBUFFER, jitter=False) as renderer:
        frame = renderer.render()
        found = decode_gbuffer(frame)
        position = frame["position"]
        depth = frame["depth"]
        ids = frame["instance_id"]
    seen = np.isfinite(depth)
    np.testing.assert_array_equal(seen, np.isfinite(camera.rays(PIXELS, SIZE)[1]).all(axis=-1))
    assert np.abs(camera.project(position[seen], SIZE) - PIXELS[seen]).max() < 0.01
    np.testing.assert_allclose(camera.unproject(PIXELS[seen], depth[seen], SIZE), position[seen], atol=1e-4)
    np.testing.assert_array_equal(found["depth"] > 0, seen)
    edges = np.abs(camera.near / found["depth"][seen] - depth[seen]) > 1e-4 * depth[seen]
    assert edges.mean() < 0.01
    for row in range(2, 7):
        center = camera.project(scene.instances[row].transform[:3, 3], SIZE)
        if not (np.abs(center - np.array(SIZE) / 2) < np.array(SIZE) / 2 - 5).all():
            continue  # beside the picture, behind the camera, or cut by the picture's edge
        for instances in (ids, found["instance"]):
            shown = np.argwhere(instances == row)
            assert len(shown)
            assert np.abs(shown.mean(axis=0)[::-1] - center).max() < 0.6


@pytest.mark.parametrize("name", [name for name in LENSES if name != "circle"])
def test_motion_follows_the_camera(device, name):
    """Motion vectors follow a camera that moves, turns and shifts its principal point, around a panorama the shorter
    way."""
    scene, before = room(name), LENSES[name]()
    after = LENSES[name]()
    step, turn = np.array((0.05, 0.03, 0.08)), np.array((0.1, 0.05, 0))
    after.place(after.position + step, after.position - after.transform[:3, 2] + turn)
    if name not in ("equirectangular", "stereo", "cube"):
        after.principal_point = np.add(after.principal_point, (0.05, -0.03))
    with make_renderer(device, scene, SIZE, passes=GBUFFER, jitter=False) as renderer:
        renderer.render(before)
        frame = renderer.render(after)
        motion = frame["motion_vectors"] * SIZE
        position = frame["position"]
        seen = np.isfinite(frame["depth"])
    expected = before.project(position, SIZE) - after.project(position, SIZE)
    if name in ("equirectangular", "stereo"):
        expected[..., 0] -= np.round(expected[..., 0] / SIZE[0]) * SIZE[0]
    seen &= np.isfinite(expected).all(axis=-1)
    assert np.abs(expected[seen]).max() > 1
    wrong = np.abs(motion - expected)[seen].max(axis=-1) > 1 / 16
    assert wrong.sum() <= 1, "a pixel at a sphere's edge, whose depth raster takes from the triangle's plane"


@pytest.mark.slow
def test_a_fisheye_shows_what_a_panorama_shows(device):
    """The path tracer's fisheye against the panorama from its place, resampled at 16 points of each pixel. Beyond the
    image circle the picture is black."""
    scene, fisheye = room(), LENSES["circle"]()
    wide = (192, 96)
    panorama = path_traced(device, scene, 192, wide)
    picture = path_traced(device, scene, 192, SIZE, fisheye)
    steps = (np.arange(4) - 1.5) / 4
    at = PIXELS[:, :, None, None] + np.stack(np.meshgrid(steps, steps), -1)
    _, directions = fisheye.rays(at, SIZE)
    inside = np.isfinite(directions).all(axis=(-1, -2, -3))
    where = np.round(scene.camera.project(np.where(np.isnan(directions), 1.0, directions), wide)).astype(int)
    expected = panorama[np.clip(where[..., 1], 0, 95), where[..., 0] % 192].mean(axis=(2, 3))
    wrong = (picture - expected)[inside] ** 2 / (expected[inside] ** 2 + 1e-2)
    print(f"relMSE {wrong.mean():.4f}, mean {picture[inside].mean() / expected[inside].mean() - 1:+.2%}")
    assert 0.4 < inside.mean() < 0.7
    assert wrong.mean() < 0.02
    assert abs(picture[inside].mean() / expected[inside].mean() - 1) < 0.01
    around = 4 * np.stack(np.meshgrid(steps, steps), -1)  # wider than the pixel
    outside = np.isnan(fisheye.rays(PIXELS[:, :, None, None] + around, SIZE)[1]).all(axis=(-1, -2, -3))
    assert outside.mean() > 0.3
    assert not picture[outside].any()


def test_raster_draws_no_lenses(device):
    with make_renderer(device, room(), SIZE, passes=GBUFFER, gbuffer="raster") as renderer:
        for camera in (None, sv.Camera(aperture=0.1)):
            with pytest.raises(SolariError, match="raster draws no lenses: leave the setting gbuffer at auto"):
                renderer.render(camera)
        assert renderer.render(LENSES["offset"]())["gbuffer_depth"].any()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["brown_conrady", "circle", "equirectangular"])
def test_denoised_frames_have_the_path_tracers_light(device, name):
    scene = room(name)
    truth = path_traced(device, scene, 256, SIZE)
    with sv.Renderer(device, scene, SIZE) as renderer:
        frames = [np.asarray(renderer.render()["radiance"]) for _ in range(24)]
        assert renderer.gbuffer == "traced"
        picked = renderer.pick(SIZE[0] // 2, SIZE[1] // 2)
    assert picked is not None
    error = np.mean((frames[-1] - truth) ** 2 / (truth**2 + 1e-2))
    print(f"relMSE {error:.4f}, mean {frames[-1].mean() / truth.mean() - 1:+.2%}")
    assert error < 0.05
    assert abs(frames[-1].mean() / truth.mean() - 1) < 0.03


test_a_seeded_bug_is_noticed = bug_tests(
    {
        "rays": (
            lambda device: test_pixels_show_what_their_rays_meet(device, "kannala_brandt"),
            Bug("scene/lens.glsl", "lens_direction", "return correct(at * 1.01, lens);"),
        ),
        "positions": (
            lambda device: test_motion_follows_the_camera(device, "stereographic"),
            Bug(
                "scene/lens.glsl", "find_lens_position", "bool seen = correct(point, lens, at); at *= 1.1; return seen;"
            ),
        ),
    }
)
