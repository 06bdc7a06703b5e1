"""Orthographic cameras: rays, G-buffers, motion, culling, and that the whole frame agrees with the path tracer."""

from __future__ import annotations

import numpy as np
import pytest
import test_raster_and_rays as gbuffer_checks
from support.measured import hold
from support.oracles import closed_forms, gbuffer
from support.realtime import GBUFFER, make_renderer
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import matte

SIZE = (48, 32)
HEIGHT = 3.4


@pytest.mark.parametrize("way", ["raster", "traced"])
def test_motion_vectors(device, way):
    hold(gbuffer_checks.measure_motion(device, way, HEIGHT))


def test_culling_changes_no_pixel(device):
    hold(gbuffer_checks.measure_culling(device, 5.0))


test_a_seeded_bug_is_noticed = bug_tests({
    "rays from one point": (
        lambda device: gbuffer_checks.measure_raster(device, gbuffer_checks.make_scene("orthographic_zoo"), SIZE),
        Bug("scene/camera.glsl", "view_line", "ViewLine line = correct(position, from); line.start = vec3(0.0); "
            "return line;")),
    "culling in perspective": (lambda device: gbuffer_checks.measure_culling(device, 5.0), Bug(
        "passes/gbuffer/cull.comp", "is_beyond", "return correct(box, normal, 0.5 * distance);")),
})  # fmt: skip


@pytest.mark.parametrize("way", ["raster", "traced"])
def test_a_tilted_floor_is_where_it_must_be(device, way):
    """Depths and positions in closed form; the footprint of a pixel doesn't depend on the distance."""
    scene = sv.Scene(sv.Instance(shapes.quad((0, 0, 0), (0, 0, 50), (50, 0, 0)), matte(0.5)))
    camera = sv.Camera.look_at((0, 7, 5), (0, 0, 0), orthographic_height=6.0, near=0.5)
    with make_renderer(device, scene, SIZE, passes=GBUFFER, gbuffer=way, jitter=False) as renderer:
        found = gbuffer.decode(renderer.render(camera))
    origins, directions = closed_forms.camera_rays(camera, *SIZE)
    expected = -origins[..., 1] / directions[..., 1]
    np.testing.assert_allclose(camera.near / found["depth"], expected, rtol=1e-5)
    with sv.PathTracer(device, scene, SIZE) as tracer:
        frame = tracer.render(camera, samples=1)
        np.testing.assert_allclose(frame["depth"], expected, rtol=1e-5)
        np.testing.assert_allclose(frame["position"], origins + directions * expected[..., None], atol=1e-4)


@pytest.mark.slow
def test_frames_agree_with_the_path_tracer(device):
    """The denoised frame of a still camera, and of one that moves, has the light that the path tracer gives."""
    scene = sv.builtin("cornell_box")
    eye, target = np.array([1, 1, -3.0]), np.ones(3)
    steps = [np.array([0.02, 0.01, 0]) * k for k in range(12)]
    cameras = [sv.Camera.look_at(eye + step, target + step, orthographic_height=2.4) for step in steps]
    with sv.PathTracer(device, scene, SIZE, seed=3) as tracer:
        truth = tracer.render(cameras[-1], samples=512)["radiance"].copy()
    with sv.Renderer(device, scene, SIZE, seed=4) as renderer:
        for camera in [cameras[0]] * 24 + cameras:
            radiance = renderer.render(camera)["radiance"].copy()
    assert np.isfinite(radiance).all()
    dark = truth.max(axis=2) < 3  # the lamp itself aside
    assert np.abs(radiance[dark].mean() / truth[dark].mean() - 1) < 0.03
    apart = np.abs(radiance - truth).mean(axis=2) / truth[dark].mean()
    assert np.median(apart) < 0.06
    assert np.mean(apart[dark]) < 0.15
