"""Environment maps: what the conformance group `environments` doesn't measure. Mitsuba, edits, both ways to trace,
other lighting, and seeded bugs that the group's rules notice."""

from __future__ import annotations

import numpy as np
import pytest
import test_environment_maps as environment_checks
from support import brdf, mitsuba_scene
from support.frames import each_lighting
from support.measured import hold
from support.oracles import environments
from support.realtime import make_renderer, trace
from test_environment_maps import floor_scene, map_with_sun, random_map, turned

import solari_vk as sv
from solari_vk.bound.lights import environment_buffers
from solari_vk.bound.lights.environment_buffers import EnvironmentBuffers
from solari_vk.scene import shapes
from solari_vk.scene.builtin import matte, rgb


@pytest.mark.slow  # eight million texels; the conformance suite measures a smaller map
def test_a_sun_in_a_large_map_adds_no_bias(device):
    hold(environment_checks.measure_sun(device, 4096))


@pytest.mark.slow  # the conformance suite measures the default lighting
@each_lighting
def test_all_frames_have_the_path_tracers_light(device, lighting):
    hold(environment_checks.measure_means(device, environment_checks.FAST, **lighting))


def test_a_table_that_ignores_the_map_is_noticed(device, monkeypatch):
    """Texels are taken alike: still unbiased, but noisy where the map has a sun."""
    monkeypatch.setattr(environment_buffers, "texel_weights", lambda image: np.ones(image.shape[:2]))
    found = {measured.rule: measured for measured in environment_checks.measure_texels(device)}
    assert not found[environment_checks.TEXELS].holds
    noisy = {measured.rule: measured for measured in environment_checks.measure_sun(device, 256)}
    assert not noisy[environment_checks.NOISE].holds


@pytest.mark.parametrize("seed", range(3))
def test_a_white_floor_reflects_its_irradiance(device, seed):
    scene = sv.Scene(sv.Camera.look_at((0, 0, 4), (0, 0, 0), vertical_fov=0.3))
    scene.add(shapes.quad((0, 0, 0), (2, 0, 0), (0, 2, 0)), sv.Material(base_color=rgb(1)))
    scene.environment = environment = sv.Environment(random_map(seed + 10), rotation=turned(seed))
    found = trace(device, scene, 4096, (8, 8), lambert=True, max_bounces=4).mean(axis=(0, 1))
    np.testing.assert_allclose(found / (environments.irradiance(environment, (0, 0, 1)) / np.pi), 1, atol=0.01)


def test_white_materials_reflect_a_random_map_by_their_brdf(device):
    """Seen at 45 degrees in parallel rays: the sum of BRDF times radiance times cosine over a grid of directions."""
    wo = np.array((1, 0, 1)) / np.sqrt(2)
    scene = sv.Scene(sv.Camera.look_at(4 * wo, (0, 0, 0), orthographic_height=4))
    scene.environment = environment = sv.Environment(random_map(5), rotation=turned(5))
    wi, solid = brdf.hemisphere_grid(300, 600)
    weights = environments.radiance(environment, wi.reshape(-1, 3)).reshape(wi.shape) * wi[..., 2:] * solid[..., None]
    expected = []
    for row, (metallic, roughness) in enumerate(((1.0, 0.6), (1.0, 0.3), (0.0, 0.4), (0.5, 0.8))):
        white = sv.Material(base_color=rgb(1), metallic=metallic, perceptual_roughness=roughness)
        scene.add(shapes.quad((0, 1.5 - row, 0), (2, 0, 0), (0, 0.5, 0)), white)
        expected.append((brdf.Surface(1.0, metallic, roughness).value(wo, wi) * weights).sum(axis=(0, 1)))
    found = trace(device, scene, 4096, (8, 16), max_bounces=4).reshape(4, -1, 3).mean(axis=1)
    np.testing.assert_allclose(found / expected, 1, atol=0.01)


def test_edits_of_a_map_show_at_once(device, monkeypatch):
    made = []
    init = EnvironmentBuffers.__init__
    monkeypatch.setattr(EnvironmentBuffers, "__init__", lambda *a: (made.append(a[-1]), init(*a))[1])
    scene = sv.Scene(sv.Camera.look_at((0, 0, 0), (1, 0, 0)))
    image = np.zeros((2, 4, 3), np.float32)
    image[:, 1:3] = 1  # the middle column is +x

    with sv.PathTracer(device, scene, (4, 4)) as tracer:

        def seen():
            return float(tracer.render(scene.camera, samples=1)["radiance"][2, 2, 0])

        assert seen() == 0
        scene.environment = sv.Environment(image)
        assert seen() == 1
        scene.environment.intensity = 0.5
        assert seen() == 0.5
        scene.environment.rotation = np.pi
        assert seen() == 0
        assert len(made) == 1, "neither intensity nor rotation makes the map anew"
        scene.environment.image = 2.0
        assert seen() == 1
        assert len(made) == 2
        scene.environment = None
        assert seen() == 0
        assert not scene.lights


def test_rays_by_queries_and_pipelines_see_the_same(any_device):
    scene = floor_scene(matte(0.5), shapes_ball())
    scene.environment = map_with_sun(8, 50.0)
    pictures = []
    for rays in ("query", "pipeline"):
        with sv.Device(validation=True, rays=rays) as device:
            pictures.append(trace(device, scene, 4, (24, 16), seed=3))
    assert pictures[0].tobytes() == pictures[1].tobytes()


@pytest.mark.slow  # the driver compiles all passes twice
@each_lighting
def test_frames_by_queries_and_pipelines_are_the_same(any_device, lighting):
    pictures = []
    for rays in ("query", "pipeline"):
        scene = floor_scene(matte(0.5), shapes_ball())
        scene.environment = map_with_sun(8, 50.0)
        with (
            sv.Device(validation=True, rays=rays) as device,
            make_renderer(device, scene, (24, 16), **lighting) as renderer,
        ):
            for _ in range(3):
                frame = renderer.render(scene.camera)
            pictures.append(frame["radiance"])
    assert pictures[0].tobytes() == pictures[1].tobytes()


def shapes_ball():
    """A shiny ball on the floor."""
    return sv.Instance(shapes.sphere(0.5, 12), sv.Material(metallic=1.0, roughness=0.2), (0, 0.5, 0))


def test_mitsubas_floor_gets_the_same_light(device):
    """Mitsuba's map has its rows from pole to pole, and so do the pixels that both are sampled from."""
    mi = mitsuba_scene.select_variant(vectorized=False)
    height, width = 64, 128
    polar = np.pi * np.arange(height) / (height - 1)  # Mitsuba's first and last rows are the poles
    longitude = 2 * np.pi * ((np.arange(width) + 0.5) / width - 0.5)
    environment = sv.Environment(smooth_map(polar_of(256), longitude_of(512)), rotation=0.7)
    scene = floor_scene(sv.Material(base_color=rgb((0.8, 0.5, 0.2))))
    scene.environment = environment
    ours = trace(device, scene, 2048, (16, 16), lambert=True, max_bounces=1).mean(axis=(0, 1))

    emitter = mitsuba_scene.environment_of(mi, environment, smooth_map(polar, longitude))
    live = mitsuba_scene.scene_of(mi, scene, 16, 16, bounces=1, lambert=True, emitters={"map": emitter})
    theirs, variance = mitsuba_scene.render(mi, live, 8, 64, seed=1)
    error = 4 * np.sqrt(variance.mean(axis=(0, 1)) / 256) / theirs.mean(axis=(0, 1))
    np.testing.assert_allclose(ours / theirs.mean(axis=(0, 1)), 1, atol=0.005 + error.max())


def polar_of(height):
    return np.pi * (np.arange(height) + 0.5) / height


def longitude_of(width):
    return 2 * np.pi * ((np.arange(width) + 0.5) / width - 0.5)


def smooth_map(polar, longitude):
    """Radiance (height, width, 3) that is brightest on one side, in other places for each color."""
    around = np.stack([1 + 0.9 * np.sin(longitude + turn) for turn in (0.0, 1.0, 3.0)], axis=-1)
    return (around * (1 + np.cos(polar))[:, None, None] ** 2).astype(np.float32)
