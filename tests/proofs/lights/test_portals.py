"""Portals: they change no mean, wherever they are, and make rooms with windows less noisy."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest
from oracles import mitsuba_scene
from oracles.light import ALBEDO, environment_irradiance, floor_scene, polygon_irradiance
from support.frames import (
    PATHS,
    PLAIN_PATHS,
    Effort,
    each_lighting,
    frames_in_history,
    make_renderer,
    measure_paths,
    observe_runs,
    path_traced,
    path_traced_runs,
)
from support.seeded_bugs import Bug, Measurement, Rule, bug_tests, require
from support.statistics import assert_equal, compare, compare_picture, measure_mean

import solari_vk as sv
from solari_vk.bound.lights import light_leaves
from solari_vk.lab.measure.portals import window_room
from solari_vk.scene import shapes
from solari_vk.scene.builtin import place, rgb

_CLOSED = ("closed form", "Lambert 1760, and irradiance by a sum over directions")
OPENING = np.array([(-0.5, 2, -1), (1.5, 2, -1), (1.5, 2, 1), (-0.5, 2, 1)], np.float64)
POINTS = [(0, 0, 0), (0.7, 0, 0.4), (-1.5, 0, 1), (0.5, 1.9, 0), (1.3, 1.99, 0.9)]
LOOSE = {
    "exact": [((0.5, 2, 0), (1, 0, 0), (0, 0, 1))],
    "too small": [((0.5, 2, 0), (0.3, 0, 0), (0, 0, 0.2))],
    "too large and slanted": [((0.7, 2.2, 0), (2, 0.3, 0), (0.5, 0, 2))],
    "two that overlap, one elsewhere": [
        ((0.2, 2, 0), (0.7, 0, 0), (0, 0, 1)),
        ((0.8, 2.1, 0), (0.7, 0, 0), (0, 0, 0.5)),
        ((0, -1, 0), (1, 0, 0), (0, 1, 0)),
    ],
}
MEANS = Rule("a frame of a room with portals has the path tracer's mean without them")
GAIN = Rule("error (relMSE) of the path tracer with a portal over that without it")
FRAMES_GAIN = Rule("error (relMSE) of raw frames with a portal over that without it")
OUTSIDE = Rule("variance far from a portal over that without it")
EFFORT, CLOSE = Effort(24, 16, 32, 2048), Effort(128, 8, 32)


def add_portals(scene, portals):
    for fields in portals:
        scene.add(sv.Portal(*fields))


def plate_with_opening():
    """A black plate with an opening below a sky of one color."""
    (x0, y, z0), (x1, _, z1) = OPENING[0], OPENING[2]
    far, black = 500.0, sv.Material(base_color=0, specular=0)
    scene = sv.Scene()
    for low_x, high_x, low_z, high_z in (
        (-far, x0, -far, far),
        (x1, far, -far, far),
        (x0, x1, -far, z0),
        (x0, x1, z1, far),
    ):
        corners = [(low_x, y, low_z), (high_x, y, low_z), (high_x, y, high_z), (low_x, y, high_z)]
        scene.add(shapes.polygons(corners), black)
    scene.environment = sv.Environment(100.0)
    return scene


def measure_opening(device, name):
    """The illuminance below an opening is the closed form, within four standard errors and 0.2 %."""
    scene = plate_with_opening()
    add_portals(scene, LOOSE[name])
    found = sv.illuminance(device, scene, POINTS, samples=2**17)
    expected = polygon_irradiance(POINTS, [(0, 1, 0)], OPENING, 100)
    beyond = np.maximum(np.abs(found.lux - expected) - 4 * found.standard_error, 0) / expected
    yield Measurement(Rule(f"illuminance below an opening, {name}", *_CLOSED), float(beyond.max()), 0.002)
    noise = float((found.standard_error / expected).max())
    yield Measurement(Rule(f"standard error, {name}", *_CLOSED), noise, 0.02)


def measure_open_floor(device, strategy):
    """A Lambert floor under a random map, with portals that stand around on it and in it."""
    generator = np.random.default_rng(1)
    image = np.exp(generator.normal(size=(8, 16, 3))).astype(np.float32)
    image[generator.random((8, 16)) < 0.2] = 0
    scene = floor_scene(sv.Material(base_color=ALBEDO))
    scene.environment = environment = sv.Environment(image, rotation=2.0)
    add_portals(
        scene,
        [
            ((0, 0.5, 0), (1, 0, 0), (0, 0.5, 0)),
            ((0.5, 1.5, 0.3), (0.5, 0.2, 0), (0, 0, 0.7)),
            ((-1, 0, 0.5), (0.3, 0, 0), (0.2, 1, 1)),
        ],
    )
    made = path_traced_runs(device, scene, (16, 16), 8192, max_bounces=1, lambert=True, light_strategy=strategy)
    expected = environment_irradiance(environment, (0, 1, 0)) * ALBEDO / math.pi
    yield from compare_picture(f"an open floor with portals, {strategy}", _CLOSED, made, expected, 0.01)


def close_portals():
    """A floor so wide that rays leave it 2 cm above it, where portals let half of the light through."""
    image = np.exp(np.random.default_rng(1).normal(size=(8, 16, 3))).astype(np.float32)
    floor = sv.Instance(shapes.quad((0, 0, 0), (0, 0, 1e4), (1e4, 0, 0)), sv.Material(base_color=ALBEDO))
    scene = sv.Scene(floor, sv.Camera.look_at((0, 0.2, 0), (0, 0, 0), up=(0, 0, 1), vertical_fov=0.3))
    scene.environment = sv.Environment(image, rotation=2.0)
    add_portals(scene, [((0, 0.022, 0), (0.04, 0, 0), (0, 0, 0.04)), ((0.05, 0.04, 0), (0.03, 0.02, 0), (0, 0, 0.05))])
    return scene, environment_irradiance(scene.environment, (0, 1, 0)) * ALBEDO / math.pi


def measure_close(device):
    """Light samples and rays by the path tracer."""
    scene, expected = close_portals()
    made = path_traced_runs(device, scene, (16, 16), 4096, max_bounces=1, lambert=True)
    yield from compare_picture("a floor close below portals", _CLOSED, made, expected, 0.01)


def measure_close_frames(device, restir):
    scene, expected = close_portals()
    settings = {**PLAIN_PATHS, "restir": restir, "lambert": True, "paths_bounces": 1, "passes": PATHS}
    with make_renderer(device, scene, (16, 16), **settings) as renderer:
        found = observe_runs(
            renderer, scene.camera, CLOSE, lambda frame: frame["raw_radiance"].mean(axis=(0, 1), dtype=np.float64)
        )
    yield measure_mean(Rule("frames of a floor close below portals", *_CLOSED), found, expected, 0.012, CLOSE)


def room(portals=(), *, glass=True):
    """A room with a window, with metal, a mirror, a lamp and a sun beside the sky; glass: with a pane."""
    sky = sv.Environment(np.random.default_rng(3).random((4, 8, 3)).astype(np.float32) ** 3 * 3000)
    scene = window_room(sky, with_portal=False)
    metal = sv.Material(base_color=rgb(0.9), metallic=1.0, roughness=0.3)
    mirror = sv.Material(base_color=rgb(0.9), metallic=1.0, roughness=0.0)
    pane = sv.Material(base_color=rgb((0.9, 1, 0.9)), transmission=1.0, roughness=0.0, double_sided=True)
    scene.add(shapes.sphere(0.4), metal, place(at=(1.5, 0.4, 1)))
    scene.add(shapes.quad((2, 1.2, 0.05), (0.8, 0, 0), (0, 0.8, 0)), mirror)
    if glass:
        scene.add(shapes.quad((5.05, 1.4, 2), (0, 0.4, 0), (0, 0, 0.5)), pane)
    scene.add(sv.PointLight((1, 2, 3), intensity=20))
    scene.add(sv.DirectionalLight((-1, -0.3, 0.2), illuminance=2000))
    add_portals(scene, portals)
    return scene


WINDOW = ((5.1, 1.4, 2), (0, 0.4, 0), (0, 0, 0.5))
IN_ROOM = [WINDOW, ((5.3, 1.3, 2.1), (0.1, 0.5, 0), (0, 0, 0.6)), ((2.5, 1.5, 0), (1, 0, 0), (0, 1, 0))]


def measure_room(device, samples=512):
    """Pictures of the room with and without portals, tile by tile."""
    with_portals, without = (
        path_traced_runs(device, room(given), (48, 32), samples, max_bounces=8) for given in (IN_ROOM, ())
    )
    yield from compare_picture("a room with portals", (), with_portals, without.mean, 0.05, without.variance)


def measure_gain(device):
    scenes = [window_room(sv.Environment(1000.0), with_portal=given) for given in (True, False)]
    after, before = (path_traced_runs(device, scene, (48, 32), 128, max_bounces=4) for scene in scenes)
    yield Measurement(GAIN, _relative(after.variance, before.mean) / _relative(before.variance, before.mean), 0.3)


def measure_frames_gain(device):
    """Of frames 5 to 24, against the path tracer."""
    scenes = [window_room(sv.Environment(1000.0), with_portal=given) for given in (True, False)]
    truth = path_traced(device, scenes[1], 2048, (48, 32))
    errors = []
    for scene in scenes:
        with make_renderer(device, scene, (48, 32), jitter=False) as renderer:
            frames = [np.asarray(renderer.render()["raw_radiance"], np.float64) for _ in range(24)][4:]
        errors.append(_relative(np.mean([(frame - truth) ** 2 for frame in frames], axis=0), truth))
    yield Measurement(FRAMES_GAIN, errors[0] / errors[1], 0.5)


def _relative(squares, mean):
    return float((squares / np.maximum(mean, mean.mean() / 10) ** 2).mean())


def measure_outside(device):
    """A floor under a sky and a sun, 40 m away from a window: half of the sky's samples go through it, none of the
    sun's."""
    variances = []
    for portals in ([((40, 1, 0), (0, 0.5, 0), (0, 0, 0.5))], []):
        scene = floor_scene(sv.Material(base_color=ALBEDO))
        image = np.exp(2 * np.random.default_rng(5).normal(size=(16, 32, 3)))
        scene.environment = sv.Environment(20 * image.astype(np.float32))
        scene.add(sv.DirectionalLight((0.2, -1, 0), illuminance=300.0))
        add_portals(scene, portals)
        made = path_traced_runs(device, scene, (16, 16), 512, max_bounces=1, lambert=True)
        variances.append(made.variance.mean())
    yield Measurement(OUTSIDE, float(variances[0] / variances[1]), 1.5)


@functools.cache
def _expected(device):
    return path_traced(device, room(), EFFORT.samples).mean(axis=(0, 1))


def measure_room_paths(device):
    """Paths without the world cache, with several light samples each, tile by tile."""
    yield from measure_paths(device, room(IN_ROOM, glass=False), 2048, {"several": (Effort(8, 0, 128), 0.02)})


def measure_frames(device, **settings):
    scene = room(IN_ROOM)
    with make_renderer(device, scene, **settings) as renderer:
        found = observe_runs(
            renderer, scene.camera, EFFORT, lambda frame: frame["radiance"].mean(axis=(0, 1), dtype=np.float64)
        )
    yield measure_mean(MEANS, found, _expected(device), 0.04, EFFORT)


def _exact(device):
    return measure_opening(device, "exact")


def _floor(device):
    return measure_open_floor(device, "mis")


@pytest.mark.parametrize(
    "measure",
    [
        *(pytest.param(lambda device, name=name: measure_opening(device, name), id=name) for name in LOOSE),
        _floor,
        measure_close,
        measure_gain,
        measure_outside,
        pytest.param(measure_frames_gain, marks=pytest.mark.slow),
        pytest.param(
            lambda device: measure_open_floor(device, "nee"), id="floor by light samples", marks=pytest.mark.slow
        ),
        pytest.param(measure_room, id="room", marks=pytest.mark.slow),
        pytest.param(measure_room_paths, id="paths", marks=pytest.mark.slow),
    ],
)
def test_rules_hold(device, measure):
    require(measure(device))


@pytest.mark.slow
@pytest.mark.parametrize("restir", [False, True])
def test_frames_of_a_floor_close_below_portals(device, restir):
    require(measure_close_frames(device, restir))


@pytest.mark.slow
@each_lighting
def test_frames_have_the_light_of_a_room_without_portals(device, lighting):
    require(measure_frames(device, **lighting))


@pytest.mark.slow
def test_a_room_with_a_portal_is_mitsubas(picture):
    """The same integral, which Mitsuba samples without portals."""

    def radiance(polar, width):
        longitude = 2 * np.pi * ((np.arange(width) + 0.5) / width - 0.5)
        return (
            500
            * (1 + np.sin(longitude))[None, :, None]
            * (1 + np.cos(polar))[:, None, None]
            * np.array((0.5, 0.8, 1.0))
        ).astype(np.float32)

    scene = window_room(sv.Environment(radiance(np.pi * (np.arange(256) + 0.5) / 256, 512)), with_portal=True)
    mitsuba = mitsuba_scene.select_variant(vectorized=False)
    pixels = radiance(np.linspace(0, np.pi, 64), 128)  # Mitsuba's first and last rows are the poles
    emitters = {"map": mitsuba_scene.environment_of(mitsuba, scene.environment, pixels)}
    live = mitsuba_scene.scene_of(mitsuba, scene, 48, 32, bounces=4, lambert=True, emitters=emitters)
    mean, variance = mitsuba_scene.render(mitsuba, live, 8, 128)
    made = picture(scene, (48, 32), 2048, max_bounces=4, lambert=True)
    assert_equal(compare(made.mean, made.variance, mean, variance), 0.03, "a room with a portal")


def test_edits_of_portals_and_environments_leave_the_picture(device):
    """Portals that come, move and go while rendering, and environments behind them."""
    scene, point = plate_with_opening(), (0.3, 0, 0.2)
    scene.add(shapes.quad((0, 0, 0), (0, 0, 9), (9, 0, 0)), sv.Material(base_color=0.5))
    scene.add(sv.Camera.look_at((0.3, 1, 0.2), point, up=(0, 0, 1), vertical_fov=0.05))
    irradiance = float(polygon_irradiance([point], [(0, 1, 0)], OPENING, 1)[0])
    with sv.PathTracer(device, scene, (16, 16), lambert=True, max_bounces=1) as tracer:

        def check(radiance):
            seen = tracer.render(samples=64)["radiance"].mean(dtype=np.float64)
            assert seen == pytest.approx(radiance * irradiance * 0.5 / math.pi, rel=0.05)

        check(100)
        portal = scene.add(sv.Portal(*LOOSE["exact"][0]))
        check(100)
        portal.center = (0.2, 2.0, 0.1)
        check(100)
        scene.environment.intensity = 3.0
        check(300)
        other = scene.add(sv.Portal(*LOOSE["too small"][0]))
        scene.environment = sv.Environment(50.0)
        check(50)
        scene.remove(portal)
        check(50)
        scene.environment = None
        check(0)
        scene.environment = sv.Environment(20.0)
        check(20)
        scene.remove(other)
        check(20)


def test_outside_notices_a_larger_share(device, monkeypatch):
    monkeypatch.setattr(light_leaves, "PORTAL_SHARE", 0.9)
    with pytest.raises(AssertionError):
        require(measure_outside(device))


@pytest.mark.slow
def test_portals_shorten_no_histories(device):
    """Nothing changes its light when a portal comes, moves or goes."""
    scene = window_room(sv.Environment(1000.0), with_portal=True)
    portal = sv.Portal(*WINDOW)
    edits = {4: lambda: scene.add(portal), 6: lambda: portal.update(center=(1, 1, 1)), 8: lambda: scene.remove(portal)}
    with make_renderer(device, scene, (32, 24), denoise=True, jitter=False) as renderer:
        for number in range(10):
            edits.get(number, lambda: None)()
            frame = renderer.render()
        lengths = frames_in_history(frame)
    assert np.median(lengths) == 10
    assert lengths.mean() > 9.5


WINDOWS = "scene/lights/portal_sampling.glsl"
PORTAL = "scene/lights/portal.glsl"
SAMPLING = "scene/sampling.glsl"
_TWICE = Bug(WINDOWS, "sum_portal_pdfs", "return 0.0;")
_DARKER = Bug(
    PORTAL,
    "sample_for_receiver_portal",
    "ResolvedLightSample found = correct(light_sample, receiver); found.radiance *= 0.7; return found;",
)
_BRIGHTER = Bug(
    PORTAL,
    "sample_for_receiver_portal",
    "ResolvedLightSample found = correct(light_sample, receiver); found.radiance *= 3.0; return found;",
)
test_a_seeded_bug_is_noticed = bug_tests(
    {
        "what portals sample counts twice": (_exact, _TWICE),
        "portals are seen from one side": (
            _floor,
            Bug(
                WINDOWS,
                "evaluate_portal_pdf",
                "return dot(direction, portals.at[index].normal) < 0.0 ? 0.0 : correct(index, origin, direction);",
            ),
        ),
        "a wrong density": (
            _exact,
            Bug(WINDOWS, "evaluate_portal_pdf", "return 0.5 * correct(index, origin, direction);"),
        ),
        "rays count as if no portal were sampled": (_exact, Bug(SAMPLING, "portal_choice_ratio", "return 1e-6;")),
        "less light through portals": (_floor, _DARKER),
        "rooms": (measure_room, _DARKER),
        "paths": (measure_room_paths, _BRIGHTER),
        MEANS: (measure_frames, _DARKER),
        GAIN: (measure_gain, _BRIGHTER),
        FRAMES_GAIN: (measure_frames_gain, _BRIGHTER),
    }
)
