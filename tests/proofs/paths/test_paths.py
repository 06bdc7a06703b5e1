"""One path a pixel: closed forms, the path tracer's mean with and without the world cache, and noise over frames."""

import functools
import math

import numpy as np
import pytest
from oracles.light import LAMP_CORNERS, floor_scene, lamp_above, lamp_on_lambert, sun_irradiance
from support.frames import (
    CACHED,
    FRAME_SIZE,
    JITTER_PERIOD,
    ONE,
    ONE_TILES,
    PATHS,
    PATHS_DEFAULT,
    PLAIN_PATHS,
    SEVERAL_TILES,
    Effort,
    make_renderer,
    measure_paths,
    metal_gallery,
    observe_runs,
    path_traced,
    read_radiance,
    replicate,
)
from support.seeded_bugs import Bug, Measurement, Rule, bug_tests, require
from support.statistics import measure_mean, measure_picture_tiles

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import SCENES, closed_box, matte, rgb

SEQUENCE = Rule("consecutive frames average to less noise than independent ones")
CELLS = Rule("cells over a shiny floor in the sun have the path tracer's irradiance")

# ---- closed forms -----------------------------------------------------------------------------------

CENTER = LAMP_CORNERS.mean(axis=0)
# Corners of lamps over a floor: a lamp of 1 m, one of 1 cm, and one that nearly touches the floor.
LAMPS = {
    "wide": LAMP_CORNERS,
    "tiny": CENTER + 0.01 * (LAMP_CORNERS - CENTER),
    "near": np.array([(-1.5, 0.2, -1.5), (1.5, 0.2, -1.5), (1.5, 0.2, 1.5), (-1.5, 0.2, 1.5)]),
}
CANDIDATES = {"one": {}, "several": {"paths_candidates": 8}}
LIGHT = Rule("the light of a Lambert floor is its closed form", "closed form", "irradiance")
TILES = Rule("each of 4 x 4 tiles of a Lambert floor is its closed form", "closed form", "irradiance")


def measure_floor(device, scene, expected, **settings):
    """Require that the picture of a Lambert floor is `expected`."""
    effort = Effort(16, 0, 32)
    chosen = {**PLAIN_PATHS, "jitter": True, "lambert": True, "paths_bounces": 1, **settings}
    with make_renderer(device, scene, FRAME_SIZE, passes=PATHS, **chosen) as renderer:
        found = observe_runs(renderer, scene.camera, effort, read_radiance) * (expected > 0)
    tiles = measure_picture_tiles(TILES, found, expected, 0.02, effort)
    require([measure_mean(LIGHT, found, expected, 0.005, effort), tiles])


@pytest.mark.slow
@pytest.mark.parametrize(("lamp", "candidates"), [("wide", "several"), ("tiny", "one"), ("near", "several")])
def test_lamp_over_a_floor(device, lamp, candidates):
    scene = floor_scene(sv.Material(base_color=rgb((0.8, 0.5, 0.2))), lamp_above(LAMPS[lamp]))
    expected = lamp_on_lambert(scene, FRAME_SIZE[0], LAMPS[lamp])
    measure_floor(device, scene, expected, **CANDIDATES[candidates])


@pytest.mark.parametrize("diameter", [0.8, pytest.param(0.0093, marks=pytest.mark.slow)])
def test_sun_over_a_floor(device, diameter):
    sun = sv.DirectionalLight(direction=rgb((1, -1.5, 0.3)), illuminance=10.0, angular_diameter=diameter)
    scene = floor_scene(sv.Material(base_color=rgb(0.6)), sun)
    irradiance = sun_irradiance(10.0, diameter, 1.5 / math.sqrt(1 + 1.5**2 + 0.3**2))
    measure_floor(device, scene, np.full((*FRAME_SIZE, 3), irradiance * 0.6 / math.pi))


# ---- the path tracer's means ------------------------------------------------------------------------


@pytest.mark.slow
def test_metals_have_the_path_tracers_means(device):
    plain = Effort(16, 0, 128), 0.01
    cached = Effort(16, 24, 64), 0.02, 0.1
    require(measure_paths(device, metal_gallery(), 8192, {"one": plain, "several": plain, "cached": cached}))


# The frames of each of 16 runs, and the bar of the mean: about twice the interval. Small lights among many boxes are
# found by chance alone with one sample a vertex, hence the wide bar.
EFFORTS = {"many_lights": (64, 0.06), "rooms": (64, 0.06), "shiny_floor": (128, 0.02), "mirror_hall": (128, 0.015)}
CHANGED = {"many_lights": {"sphere_count": 49, "box_count": 300}, "rooms": {"columns": 2, "rows": 1}}


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_without_the_cache_paths_are_the_path_tracers(device, name):
    """P-REPL: with one light sample a vertex, and with several."""
    frames, bar = EFFORTS.get(name, (64, 0.01))
    scene = sv.builtin(name, **CHANGED.get(name, {}))
    run = Effort(16, 0, frames), bar
    require(measure_paths(device, scene, 8192, {"one": run, "several": run}))


@pytest.mark.slow
def test_lamp_under_a_ceiling(device):
    scene = sv.builtin("lamp_gap", gap=0.01)
    plain = Effort(16, 0, 64), 0.01
    cached = Effort(16, 24, 64), 0.02, 0.1
    require(measure_paths(device, scene, 8192, {"one": plain, "several": plain, "cached": cached}))


# ---- frames -----------------------------------------------------------------------------------------


def measure_sequence(device):
    """The variance of the mean of 32 frames, over a 32nd of a frame's variance, where walls glow and reflect."""
    scene, seeds = closed_box(), 8
    with make_renderer(device, scene, FRAME_SIZE, passes=PATHS, **{**PLAIN_PATHS, "paths_bounces": 1}) as renderer:
        single, means = 0.0, []
        for seed in range(seeds):
            renderer.seed = seed
            frames = np.stack([read_radiance(renderer.render(scene.camera)) for _ in range(JITTER_PERIOD)])
            single += float(frames.var(axis=0, ddof=1).mean()) / seeds
            means.append(frames.mean(axis=0))
    ratio = float(np.stack(means).var(axis=0, ddof=1).mean() / (single / JITTER_PERIOD))
    yield Measurement(SEQUENCE, ratio, 0.6, "of the variance of independent frames")


# ---- cells ------------------------------------------------------------------------------------------


_HEIGHT, _PANEL = 1.1, 0.4  # meters
_SUN = np.array((0.15, -0.75, -0.6))  # where its light travels


def _panel_over_metal(roughness):
    """A matte panel that faces a floor of metal in the sun, and a wall whose paths meet the panel from below."""
    scene = sv.Scene(sv.Camera.look_at((0.3, 0.6, 2.4), (0, 0.8, -1), vertical_fov=1.0))
    for mesh, material in (
        (
            shapes.quad((0, 0, 0), (0, 0, 3), (3, 0, 0)),
            sv.Material(base_color=rgb((0.95, 0.9, 0.8)), metallic=1.0, perceptual_roughness=math.sqrt(roughness)),
        ),
        (shapes.quad((0, _HEIGHT, 0), (_PANEL, 0, 0), (0, 0, _PANEL)), matte(0.5)),
        (shapes.quad((0, 0.5, -1.4), (1.5, 0, 0), (0, 0.5, 0)), matte(0.3)),
    ):
        scene.add(sv.Instance(mesh=mesh, material=material))
    scene.add(sv.DirectionalLight(direction=rgb(_SUN), illuminance=10.0, name="sun"))
    return scene


def measure_cells(device, roughness=0.3, runs=8, **changed):
    """The irradiance of the panel's cells, against what the path tracer sees on the panel from below."""
    scene = _panel_over_metal(roughness)
    below = sv.Camera.look_at((0, _HEIGHT - 1, 0), (0, _HEIGHT, 0), up=(0, 0, 1), vertical_fov=2 * math.atan(_PANEL))
    # What the panel shows of a known irradiance from where the floor throws the sun: matte isn't quite Lambertian.
    sun = sv.DirectionalLight(direction=rgb(_SUN * (1, -1, 1)), illuminance=1.0)
    lit = path_traced(device, sv.Scene(scene.instances[1], sun), 256, FRAME_SIZE, below, max_bounces=1).mean()
    received = sun_irradiance(1.0, sun.angular_diameter, float(-_SUN[1] / np.linalg.norm(_SUN)))
    expected = path_traced(device, scene, 2048, FRAME_SIZE, below, max_bounces=64).mean(axis=(0, 1)) * received / lit
    # All cells live until the end and are updated in every frame.
    every = {"world_cache_updates": "all", "world_cache_updates_per_pixel": 1e9, "world_cache_lifetime": 100}
    settings = {**PATHS_DEFAULT, **every, "world_cache_cell_size": 0.05, **changed}
    with make_renderer(device, scene, FRAME_SIZE, passes=PATHS, **settings) as renderer:

        def observe():
            total = np.zeros(3)
            for frame in range(32):
                renderer.render(scene.camera)
                total += _panel_irradiance(renderer) / 8 if frame >= 24 else 0.0
            return total

        found = replicate(renderer, runs, observe)
    yield measure_mean(CELLS, found[:, None, None], expected, 0.08, Effort(runs, 24, 8))


def _panel_irradiance(renderer):
    """The mean irradiance (3,) of settled cells around the panel."""
    irradiance, bounds = (renderer[f"world_cache_{name}"].astype(np.float64) for name in ("irradiance", "bounds"))
    center = bounds[:, :3] + bounds[:, 3:] / 2
    near = np.abs(center - (0, _HEIGHT, 0)) < (_PANEL, 0.2, _PANEL)
    settled = near.all(axis=-1) & (renderer["world_cache_checksums"] != 0) & (irradiance[:, 3] >= 4)
    assert settled.sum() > 50, f"only {settled.sum()} cells"
    return np.asarray(irradiance[settled, :3].mean(axis=0))


@pytest.mark.slow
def test_hit_distances_in_a_room_are_finite(device):
    """Also where the direction that the lobe gave leads into the surface, as at a ball of few faces."""
    scene = sv.Scene(sv.Camera.look_at((0, 0, 3), (0, 0, 0), vertical_fov=0.6), sv.PointLight((0, 2, 3), intensity=9.0))
    scene.add(shapes.box((-4, -4, -4), (4, 4, 4), inward=True), matte(0.5))
    scene.add(shapes.sphere(1.0, 5), sv.Material(metallic=1.0, roughness=0.5))
    with make_renderer(device, scene, FRAME_SIZE, passes=PATHS, **PLAIN_PATHS) as renderer:
        distances = [renderer.render()[f"paths_{lobe}"][..., 3] for lobe in ("diffuse", "specular") for _ in range(4)]
    assert np.isfinite(distances).all()
    assert np.max(distances) > 3


def test_frames_follow_a_sequence(device):
    require(measure_sequence(device))


@pytest.mark.slow
def test_cells_over_a_shiny_floor(device):
    require(measure_cells(device))


# ---- each rule can fail -----------------------------------------------------------------------------

PLAIN = Effort(16, 0, 16), 0.03
BRIEF = {"one": PLAIN, "several": PLAIN, "cached": (Effort(16, 16, 12), 0.03, 0.1)}


def brief(kind, device):
    """With less effort than the rules take: the bugs are larger than the bars."""
    return measure_paths(device, metal_gallery(), 1024, {kind: BRIEF[kind]})


@pytest.mark.parametrize("kind", ["one", *(pytest.param(k, marks=pytest.mark.slow) for k in ("several", "cached"))])
def test_brief_check_holds(device, kind):
    require(brief(kind, device))


PATH, VERTEX = "passes/paths/path.glsl", "passes/paths/vertex.glsl"
one, several, cached = (functools.partial(brief, kind) for kind in ("one", "several", "cached"))
test_a_seeded_bug_is_noticed = bug_tests(
    {
        # light samples without MIS weight, hits without it
        ONE: (one, Bug(VERTEX, "evaluate_next_event", "return correct(vertex, light, 1e9 * expected_candidates);")),
        ONE_TILES: (one, Bug("scene/walk.glsl", "hit_light_pdf(Receiver", "return 0.0;")),
        # several light samples are weighted as one
        SEVERAL_TILES: (
            several,
            Bug(VERTEX, "evaluate_next_event", "return correct(vertex, light, min(expected_candidates, 1.0));"),
        ),
        # the diffuse lobe is in the cache and followed
        CACHED: (
            cached,
            Bug(
                PATH,
                "look_up_world_cache",
                "bool goes_on = correct(path, surface); path.specular_only = false; return goes_on;",
            ),
        ),
        SEQUENCE: (
            measure_sequence,
            Bug(
                "passes/paths/first_ray.comp",
                "start_path",
                "Path path = correct(pixel, surface, sample_index); path.u = rand_vec2f(path.rng); return path;",
            ),
        ),
        # no specular lobe is followed
        CELLS: (measure_cells, Bug(PATH, "is_rough", "return true;")),
    }
)
