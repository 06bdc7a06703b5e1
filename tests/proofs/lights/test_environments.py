"""Environment maps: closed forms of what they send to a floor and to the camera, how often light samples take their
texels, edits, and frames against the path tracer."""

from __future__ import annotations

import math
from statistics import NormalDist
from unittest import mock

import numpy as np
import pytest
from oracles.light import ALBEDO, environment_irradiance, environment_radiance, floor_scene
from oracles.rays import camera_rays
from support.frames import (
    GBUFFER,
    LIGHT_OFF,
    Effort,
    each_lighting,
    make_renderer,
    observe_runs,
    path_traced,
    path_traced_runs,
)
from support.seeded_bugs import Bug, Measurement, Rule, bug_tests, require
from support.statistics import chi_squared_p, compare_picture, measure_mean, standard_deviations

import solari_vk as sv
from solari_vk.bound.lights import environment_buffers
from solari_vk.scene import shapes
from solari_vk.scene.builtin import matte, place, rgb
from solari_vk.scene.lights.environment import directions, luminances, solid_angles

_CLOSED = ("closed form", "irradiance by a sum over directions")
BACKGROUND = Rule("the background is the map in the direction of each pixel's ray")
MIRROR = Rule("a flat mirror shows the map in the reflected direction")
TEXELS = Rule("light samples take texels by their light")
DIRECTIONS = Rule("a light sample's direction lies in its texel, whose probability it has")
EVEN = Rule("the points of light samples are spread evenly over a texel")
NOISE = Rule("a sun of 100,000 in a map: noise of one light sample over its mean")
MEANS = Rule("a frame under a map and a sun has the path tracer's mean")
FAST, FULL = Effort(6, 16, 32, 1024), Effort(16, 32, 64, 8192)
_MAX_Z = NormalDist().inv_cdf(0.9999)
# Half a step of rgb9e5 at its coarsest, relative to the largest of three colors.
_HALF_STEP = 2.0**-9
LAMBERT = sv.Material(base_color=ALBEDO)


def turned(angle):
    """A rotation about a slanted axis."""
    axis = np.array((1.0, 2.0, -0.5)) / math.sqrt(5.25)
    cross = np.cross(np.eye(3), -axis)
    matrix = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    return matrix


def random_map(seed, height=8, width=16):
    """A map whose texels differ by orders of magnitude, some of which are black. Of numbers that rgb9e5 has."""
    generator = np.random.default_rng(seed)
    image = np.exp(1.5 * generator.normal(size=(height, width, 3))).astype(np.float32)
    image[generator.random((height, width)) < 0.2] = 0
    step = np.exp2(np.floor(np.log2(np.maximum(image.max(axis=-1, keepdims=True), 1e-9))) - 8)
    return (np.round(image / step) * step).astype(np.float32)


def measure_floor(device, strategy):
    """Lambert floors under one color, and under a random map that is turned."""
    for name, environment in (
        ("one color", sv.Environment((1.0, 0.5, 2.0), intensity=3.0)),
        ("a random map", sv.Environment(random_map(1), intensity=0.25, rotation=turned(2.0))),
    ):
        scene = floor_scene(LAMBERT)
        scene.environment = environment
        samples, bar = (8192, 0.02) if strategy == "brdf" else (4096, 0.01)
        made = path_traced_runs(device, scene, (16, 16), samples, max_bounces=1, lambert=True, light_strategy=strategy)
        expected = environment_irradiance(environment, (0, 1, 0)) * ALBEDO / math.pi
        yield from compare_picture(f"a floor under {name}, {strategy}", _CLOSED, made, expected, bar)


def measure_mirror(device, **settings):
    """What a frame shows of a map in a mirror of metal, and beside it."""
    image = random_map(2)
    scene = sv.Scene(sv.Camera.look_at((0, 0, 0), (0.1, 0, -1), vertical_fov=1.0))
    scene.environment = environment = sv.Environment(image, rotation=turned(1.0))
    normal = np.array((0.0, 0.6, 0.8))
    mirror = sv.Material(base_color=rgb(1.0), metallic=1.0, roughness=0.0)
    scene.add(shapes.quad((0, 0, -2), (9, 0, 0), (0, 0.4, -0.3)), mirror)
    with make_renderer(device, scene, (32, 32), jitter=False, **settings) as renderer:
        frame = renderer.render(scene.camera)
        seen, in_mirror = frame["radiance"], np.isfinite(frame["depth"])
    _, rays = camera_rays(scene.camera, 32, 32)
    for rule, where, along in (
        (BACKGROUND, ~in_mirror, rays),
        (MIRROR, in_mirror, rays - 2 * (rays @ normal)[..., None] * normal),
    ):
        errors = np.abs(seen[where] - environment_radiance(environment, along[where]))
        yield Measurement(rule, float(errors.max()) / (_HALF_STEP * float(image.max())), 2.0, "of a step")


def measure_texels(device):
    """The light samples of a frame."""
    scene = floor_scene(matte(1.0))
    scene.environment = environment = sv.Environment(random_map(3), rotation=turned(0.5))
    with make_renderer(device, scene, (8, 8), passes=(*GBUFFER, "solari019/light_tiles/"), **LIGHT_OFF) as renderer:
        frame = renderer.render(scene.camera)
        part, packed = frame["light_tile_samples"]["part"].ravel(), frame["light_tiles"].ravel()
    height, width = environment.image.shape[:2]
    fine = sv.Environment(environment.image)
    each = 16  # directions along each side of a texel
    light = luminances(
        environment_radiance(fine, directions(height * each, width * each).reshape(-1, 3)).astype(np.float32)
    ).reshape(height, each, width, each) * solid_angles(height * each, width * each).reshape(height, each, 1, 1)
    expected = light.sum(axis=(1, 3)).ravel()
    # Interpolated luminance is weighted by the sine at each texel's center, which the sum over directions isn't.
    z = standard_deviations(chi_squared_p(np.bincount(part, minlength=expected.size), _chances(fine) * part.size))
    yield Measurement(TEXELS, z, _MAX_Z, "standard deviations")
    far_off = np.abs(_chances(fine) - expected / expected.sum()).sum()
    yield Measurement(Rule("texels' probabilities follow their light"), float(far_off), 0.05)

    x, y, z_axis = (packed["world_position"].astype(np.float64) @ environment.rotation.astype(np.float64)).T
    column = width * (np.arctan2(z_axis, x) / (2 * np.pi) + 0.5)
    row = height * np.arctan2(np.hypot(x, z_axis), y) / np.pi
    points = np.stack([column - part % width, row - part // width])
    apart = np.abs(points - 0.5).max()
    solid_angle = 2 * np.pi**2 / (width * height) * np.hypot(x, z_axis)
    error = np.abs(packed["inverse_area_pdf"] * _chances(fine)[part] / solid_angle - 1).max()
    yield Measurement(DIRECTIONS, float(max(apart - 0.5, error)), 1e-4, "texels, or relative error")
    cells = np.floor(points * 8).clip(0, 7).astype(int)
    counts = np.bincount(cells[0] * 8 + cells[1], minlength=64)
    z = standard_deviations(chi_squared_p(counts, np.full(64, part.size / 64)))
    yield Measurement(EVEN, z, _MAX_Z, "standard deviations")


def _chances(environment):
    """The probability of each texel: luminance blurred by (1, 6, 1) / 8 both ways, times the sine of its row."""
    light = luminances(environment.image)
    blurred = (6 * light + np.roll(light, 1, axis=1) + np.roll(light, -1, axis=1)) / 8
    above, below = np.vstack([blurred[:1], blurred[:-1]]), np.vstack([blurred[1:], blurred[-1:]])
    weights = (6 * blurred + above + below) / 8 * np.sin(np.pi * (np.arange(len(light)) + 0.5) / len(light))[:, None]
    chances = (weights / weights.sum()).ravel()
    return chances


def measure_sun(device, height):
    """A floor under a dim sky, of which one texel is 100,000 times as bright as the others."""
    image = np.full((height, 2 * height, 3), (0.3, 0.5, 0.9), np.float32)
    image[height // 5, height // 3] = 1e5
    scene = floor_scene(LAMBERT)
    scene.environment = sv.Environment(image)
    above = directions(*image.shape[:2])[..., 1].clip(0) * solid_angles(*image.shape[:2])
    expected = np.einsum("yxc,yx->c", image.astype(np.float64), above) * ALBEDO / math.pi
    samples = 4096
    made = path_traced_runs(device, scene, (16, 16), samples, max_bounces=1, lambert=True)
    yield from compare_picture(f"a floor under a sun in a map {height} high", _CLOSED, made, expected, 0.01)
    deviation = np.sqrt(made.variance * samples) / made.mean
    yield Measurement(NOISE, float(deviation.mean()), 3.0, "standard deviations")


def measure_means(device, effort, **settings):
    """A floor, a matte ball and a shiny one under a map with a sun beside it."""
    scene = floor_scene(matte(0.5))
    scene.environment = sv.Environment(random_map(4), rotation=1.0)
    scene.add(sv.DirectionalLight(rgb(-1), illuminance=10.0, angular_diameter=0.1))
    scene.add(shapes.sphere(0.5, 16), matte(ALBEDO), place(at=(0.6, 0.5, 0)))
    shiny = sv.Material(base_color=rgb(0.9), metallic=1.0, roughness=0.3)
    scene.add(shapes.sphere(0.5, 16), shiny, place(at=(-0.6, 0.5, 0)))
    expected = path_traced(device, scene, effort.samples).mean(axis=(0, 1))
    with make_renderer(device, scene, **settings) as renderer:
        found = observe_runs(
            renderer, scene.camera, effort, lambda frame: frame["radiance"].mean(axis=(0, 1), dtype=np.float64)
        )
    yield measure_mean(MEANS, found, expected, 0.03, effort)


def slow(measure, *arguments, name):
    return pytest.param(lambda device: measure(device, *arguments), id=name, marks=pytest.mark.slow)


@pytest.mark.parametrize(
    "measure",
    [
        pytest.param(lambda device: measure_floor(device, "mis"), id="floor"),
        measure_mirror,
        measure_texels,
        pytest.param(lambda device: measure_sun(device, 256), id="sun"),
        slow(measure_floor, "nee", name="light samples"),
        slow(measure_floor, "brdf", name="random rays"),
        slow(measure_sun, 2048, name="large sun"),
        slow(measure_means, FULL, name="precise means"),
    ],
)
def test_rules_hold(device, measure):
    require(measure(device))


@pytest.mark.slow
@each_lighting
def test_frames_have_the_path_tracers_light(device, lighting):
    require(measure_means(device, FAST, **lighting))


def test_edits_of_a_map_show_at_once(device):
    scene = sv.Scene(sv.Camera.look_at((0, 0, 0), (1, 0, 0)))
    image = np.zeros((2, 4, 3), np.float32)
    image[:, 1:3] = 1  # the middle column is +x
    with (
        mock.patch.object(environment_buffers, "texel_weights", wraps=environment_buffers.texel_weights) as made,
        sv.PathTracer(device, scene, (4, 4)) as tracer,
    ):

        def seen():
            return float(tracer.render(scene.camera, samples=1)["radiance"][2, 2, 0])

        assert seen() == 0
        scene.environment = sv.Environment(image)
        assert seen() == 1
        scene.environment.intensity = 0.5
        assert seen() == 0.5
        scene.environment.rotation = np.pi
        assert seen() == 0
        assert made.call_count == 1, "neither intensity nor rotation makes the map anew"
        scene.environment.image = 2.0
        assert seen() == 1
        scene.environment = None
        assert seen() == 0
        assert not scene.lights


LIGHT = "scene/lights/environment.glsl"
test_a_seeded_bug_is_noticed = bug_tests(
    {
        "a floor": (
            lambda device: measure_floor(device, "mis"),
            Bug(LIGHT, "texel_solid_angle", "return correct(map, 1.0);"),
        ),
        BACKGROUND: (measure_mirror, Bug(LIGHT, "environment_radiance", "return correct(map, round(position));")),
        MIRROR: (measure_mirror, Bug(LIGHT, "evaluate_environment", "return correct(index, -direction);")),
        DIRECTIONS: (measure_texels, Bug(LIGHT, "texel_solid_angle", "return 1.01 * correct(map, polar_sine);")),
        EVEN: (
            measure_texels,
            Bug(LIGHT, "resolve_environment", "return correct(index, part, 0.2 * u, inverse_probability);"),
        ),
        TEXELS: (
            measure_texels,
            Bug(
                "scene/lights/choice.glsl",
                "choose_part",
                "return leaf.first_part + rand_range_u(leaf.part_count, rng);",
            ),
        ),
        MEANS: (
            lambda device: measure_means(device, FAST),
            Bug(
                "scene/sampling.glsl",
                "mis_weighted_radiance",
                "return 0.5 * correct(light_hit, light_probability, mis_pdf);",
            ),
        ),
    },
    quick=(EVEN,),
)
