"""Guide images against the path tracer's AOVs and closed forms, and what they hold at mirrors."""

from __future__ import annotations

import numpy as np
import pytest
from support.oracles.closed_forms import camera_rays
from support.realtime import GUIDES, make_renderer
from support.seeded_bugs import Bug, seeded

import solari_vk as sv
from solari_vk.measure.statistics import relative_mse
from solari_vk.scene import shapes
from solari_vk.scene.builtin import builtin, lamp, matte, rgb
from solari_vk.scene.model import Camera, Instance, Material, Scene

SIZE = (64, 48)
PIXEL = 1 / 16  # the largest error of a motion vector, in pixels
MIRROR = Material(base_color=rgb(0.9), metallic=1.0, perceptual_roughness=0.0, name="mirror")


@pytest.fixture
def guides(device):
    """guides(scene, **settings) -> a renderer that computes only guides, closed when the test ends."""
    made = []

    def make(scene, **settings):
        made.append(make_renderer(device, scene, SIZE, passes=GUIDES, gbuffer="traced", jitter=False, **settings))
        return made[-1]

    yield make
    for renderer in made:
        renderer.close()


# ---- ordinary surfaces ------------------------------------------------------------------------------


@pytest.mark.parametrize("scene_name", ["cornell_box", "sphere_grid"])
def test_guides_of_ordinary_surfaces_are_the_path_tracers(guides, device, scene_name):
    """Without primary surface replacement, this includes mirrors. The bounds are the formats' precision."""
    scene = builtin(scene_name)
    frame = guides(scene, primary_surface_replacement=False).render(scene.camera)
    with sv.PathTracer(device, scene, SIZE) as tracer:
        tracer.render(scene.camera, samples=1)
        albedo, normal = tracer["albedo"], tracer["shading_normal"]
        roughness, metallic = np.moveaxis(tracer["roughness_metallic"], -1, 0)
        depth = tracer["depth"]
    there = np.isfinite(depth)
    diffuse = frame["guides/diffuse_albedo"][..., :3] / 255
    np.testing.assert_allclose(diffuse[there], (albedo * (1 - metallic)[..., None])[there], atol=0.004)
    made = frame["guides/normal_roughness"].astype(float)
    np.testing.assert_allclose(made[..., :3][there], normal[there], atol=0.002)
    np.testing.assert_allclose(made[..., 3][there], roughness[there], atol=0.0025)
    np.testing.assert_allclose(np.squeeze(frame["guides/depth"])[there], scene.camera.near / depth[there], rtol=1e-5)
    assert (diffuse[~there] == 0).all()
    assert (np.squeeze(frame["guides/depth"])[~there] == 0).all()


def test_specular_albedo_is_the_directional_albedo(guides):
    """It is 1 for a white metal at every angle and roughness, and Schlick's Fresnel term for a smooth dielectric."""
    scene = Scene()
    camera = Camera.look_at((0, 1.0, 4), (0, 0, 0), vertical_fov=0.6)
    for column in range(4):
        white = Material(base_color=rgb(1.0), metallic=1.0, perceptual_roughness=(0.1, 0.3, 0.6, 1.0)[column])
        floor = shapes.quad((column - 1.5, 0, 0.5), (0, 0, 0.5), (0.5, 0, 0))
        scene.add(Instance(mesh=floor, material=white))
        glass = Material(base_color=rgb(0.0), perceptual_roughness=0.0, reflectance=rgb(0.25 + 0.25 * column))
        floor = shapes.quad((column - 1.5, 0, -0.5), (0, 0, 0.5), (0.5, 0, 0))
        scene.add(Instance(mesh=floor, material=glass))
    frame = guides(scene).render(camera)
    made = frame["guides/specular_albedo"][..., 0] / 255
    origin, directions = camera_rays(camera, *SIZE)
    positions = origin - directions * (camera.transform[1, 3] / directions[..., 1])[..., None]
    cosine = -directions[..., 1]
    on_floor = np.abs(positions[..., 0]) < 1.99
    metal = on_floor & (np.abs(positions[..., 2] - 0.5) < 0.49)
    assert np.ptp(cosine[metal]) > 0.02
    np.testing.assert_allclose(made[metal], 1.0, atol=0.01)
    glass = on_floor & (np.abs(positions[..., 2] + 0.5) < 0.49)
    f0 = 0.16 * (0.25 + 0.25 * np.clip(np.floor(positions[..., 0] + 2), 0, 3)) ** 2
    np.testing.assert_allclose(made[glass], (f0 + (1 - f0) * (1 - cosine) ** 5)[glass], atol=0.004)


# ---- mirrors ----------------------------------------------------------------------------------------


def test_an_empty_sky_in_a_mirror_turns_with_the_camera(guides):
    """The reflected sky moves when the camera turns, not when the camera moves; it has no depth and no albedo."""
    scene = Scene(Instance(mesh=shapes.quad((0, 0, 0), (2, 0, 0), (0, 2, 0)), material=MIRROR))
    renderer = guides(scene)
    near = Camera.look_at((0, 0, 2), (0, 0, 0), vertical_fov=0.9)
    moved = Camera.look_at((0.2, 0.1, 2), (0.2, 0.1, 0), vertical_fov=0.9)
    turned = Camera.look_at((0.2, 0.1, 2), (0.3, 0.1, 0), vertical_fov=0.9)
    renderer.render(near)
    frame = renderer.render(moved)
    assert np.abs(frame["guides/specular_motion"].astype(float) * SIZE).max() < PIXEL
    assert (frame["guides/depth"] == 0).all()
    assert (frame["guides/diffuse_albedo"][..., :3] == 0).all()
    assert np.abs(frame["guides/motion"].astype(float) * SIZE).max() > 1.0
    frame = renderer.render(turned)
    assert np.abs(frame["guides/specular_motion"].astype(float)[..., 0] * SIZE[0]).min() > 1.0


def test_without_replacement_mirrors_describe_themselves(guides):
    scene = Scene(
        Instance(mesh=shapes.quad((0, 0, 0), (2, 0, 0), (0, 2, 0)), material=MIRROR),
        Instance(mesh=shapes.quad((0, 0, 4), (0, 2, 0), (2, 0, 0)), material=matte(0.5)),
    )
    camera = Camera.look_at((0, 0, 2), (0, 0, 0), vertical_fov=0.9)
    frame = guides(scene, primary_surface_replacement=False).render(camera)
    np.testing.assert_allclose(frame["guides/normal_roughness"] - np.array((0, 0, 1.0, 0)), 0, atol=1e-7)
    np.testing.assert_allclose(np.squeeze(frame["guides/depth"]), camera.near / 2, rtol=1e-5)


# ---- glass ------------------------------------------------------------------------------------------


def behind_a_pane():
    """A wall of colored squares and a lamp above, seen through clear glass."""
    colors = np.random.default_rng(7).integers(20, 250, (8, 8, 3), np.uint8).repeat(8, axis=0).repeat(8, axis=1)
    glass = Material(base_color=rgb(0.95), transmission=1.0, perceptual_roughness=0.0, double_sided=True)
    scene = Scene(
        Instance(shapes.quad((0, 0, -3), (2, 0, 0), (0, 2, 0)), Material(base_color_texture=colors)),
        Instance(shapes.quad((0, 2.5, -2), (0.5, 0, 0), (0, 0, 0.5)), lamp(20.0)),
        Instance(shapes.quad((0, 0, -1), (2, 0, 0), (0, 2, 0)), glass),
    )
    scene.camera = Camera.look_at((0, 0, 1), (0, 0, -3), vertical_fov=0.8)
    return scene


def denoised_error(device, scene, truth):
    with make_renderer(device, scene, SIZE, denoise=True, antialiasing=True, seed=31) as renderer:
        for _ in range(8):
            frame = renderer.render(scene.camera)
        return relative_mse(np.asarray(frame["radiance"], np.float64)[..., :3], truth)


@pytest.mark.slow  # the driver compiles whole frames
def test_what_a_pane_shows_is_denoised_by_its_own_guides(device):
    scene = behind_a_pane()
    with sv.PathTracer(device, scene, SIZE, seed=5) as tracer:
        truth = np.asarray(tracer.render(samples=512), np.float64)
    error = denoised_error(device, scene, truth)
    with seeded(Bug("passes/guides/write.comp", "is_clear_wall", "return false;")):
        by_the_pane = denoised_error(device, scene, truth)
    print(error, by_the_pane)
    assert error < 0.05 < by_the_pane
