"""Light that pixels reuse (restir=on): the path tracer's mean, less noise, no lag, and nothing of what was removed."""

import numpy as np
import pytest
from support.frames import (
    FRAME_SIZE,
    PATHS,
    PLAIN_PATHS,
    Effort,
    add_up,
    make_renderer,
    metal_gallery,
    observe_paths,
    observe_runs,
    path_traced_reflected,
    render_frames,
    replicate,
    share_of_earlier,
    trace_centers,
    unlit_pixels,
)
from support.seeded_bugs import Bug, Measurement, Rule, bug_tests, require
from support.statistics import measure_mean, measure_tiles_t

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import cornell_box, lamp, matte, place

REUSED = Rule("paths whose light pixels reuse have the path tracer's mean")
REUSED_TILES = Rule("where pixels reuse light, no tile differs from the path tracer's")
LESS_NOISE = Rule("reuse takes at least a quarter off the variance of a frame")
NO_LAG = Rule("a frame after a block has jumped, reused light contains little of its old shadow")
REUSE = {"lighting": "paths", "restir": True}
MEAN = Rule("frames with reused light are as bright as frames without")
RESTIR = {**PLAIN_PATHS, "restir": True}
FULL = Effort(16, 24, 64, 8192)


def measure_means(device, effort=FULL, scene=None, bar=0.02, **settings):
    """Against the path tracer, for metals that show a lamp, a sun, gloss and mirrors, or for `scene`."""
    scene = scene or metal_gallery()
    measured = unlit_pixels(device, scene)
    expected = trace_centers(device, scene, effort.samples) * measured
    found = observe_paths(device, scene, effort, **{**RESTIR, **settings}) * measured
    yield measure_mean(REUSED, found, expected, bar, effort)
    yield measure_tiles_t(REUSED_TILES, found, expected)


def measure_noise(device):
    """The median of pixels' variances between runs, over the same without reuse, in a Cornell box."""
    scene = cornell_box()
    variance = [
        float(np.median(observe_paths(device, scene, Effort(16, 12, 1), **{**RESTIR, "restir": on}).var(axis=0)))
        for on in (True, False)
    ]
    yield Measurement(LESS_NOISE, variance[0] / variance[1], 0.75, "of the variance without reuse")


def measure_lag(device, runs=24):
    """How much of the picture from before a jump of a block the first frame after it contains."""
    scene = cornell_box()
    block = scene.instances["short block"]
    places, pictures = [place(at=(x, 0.15, 0.0)) for x in (0.0, 0.3)], []
    for block.transform in places:
        pictures.append(path_traced_reflected(device, scene, 512))
    shown = np.logical_and(*(picture > 0 for picture in pictures))
    before, now = (picture * shown for picture in pictures)
    with make_renderer(device, scene, FRAME_SIZE, passes=PATHS, **REUSE) as renderer:

        def observe():
            for frame in range(13):
                block.transform = places[frame == 12]
                picture = add_up(renderer.render(scene.camera))
            return share_of_earlier(before, now, picture)

        found = replicate(renderer, runs, observe)
    note = f"+- {2 * found.std() / runs**0.5:.3f}"
    yield Measurement(NO_LAG, abs(float(found.mean())), 0.1, "of the old picture", note)


def lit_by_a_wall():
    """A floor that no lamp lights and that fills the picture: its light comes from a lamp below it by a wall above."""
    scene = sv.Scene(sv.Camera.look_at((0, 1.2, 0.4), (0, 0, 0), vertical_fov=0.8))
    for name, mesh, material in (
        ("floor", shapes.quad((0, 0, 0), (0, 0, 1), (1, 0, 0)), matte(0.8)),
        ("wall", shapes.quad((0, 3, 0), (3, 0, 0), (0, 0, 3)), matte(0.9)),
        ("lamp", shapes.quad((0, -0.5, 0), (0, 0, 2), (2, 0, 0)), lamp(5.0)),
    ):
        scene.add(sv.Instance(mesh=mesh, material=material, name=name))
    return scene


@pytest.mark.slow
@pytest.mark.parametrize(("make", "name"), [(cornell_box, "lamp"), (lit_by_a_wall, "wall")])
def test_what_was_removed_lends_no_light(device, make, name):
    """Without the only lamp, or without the only surface that its light comes from, the next frame is black."""
    scene = make()
    with make_renderer(device, scene, FRAME_SIZE, world_cache=False, **REUSE) as renderer:
        before = add_up(render_frames(renderer, scene.camera, 8))
        scene.remove(scene.instances[name])
        after = add_up(renderer.render(scene.camera))
    assert (before > 0).mean() > 0.1
    assert not after.any()


@pytest.mark.slow
def test_many_lights(device):
    scene, effort = sv.builtin("many_lights", sphere_count=49, box_count=300), Effort(16, 24, 64)
    without, found = (observe(device, scene, effort, restir) for restir in (False, True))
    require([measure_mean(MEAN, found, without.mean(axis=0), 0.02, effort)])


def coated_floor():
    """A dark rough floor below a smooth coat, which mirrors an unlit card, a lamp, and a wall that a point lights."""
    camera = sv.Camera.look_at((0, 0.8, 1.2), (0, 0, 0), vertical_fov=0.5)
    scene = sv.Scene(camera, sv.PointLight((0, 1.5, -0.5), intensity=3.0))
    dark = sv.Material(base_color=0.05, roughness=0.8, clearcoat=1.0, clearcoat_roughness=0.0)
    for mesh, material in (
        (shapes.quad((0, 0, 0), (0, 0, 3), (3, 0, 0)), dark),
        (shapes.quad((0, 1, -2), (2, 0, 0), (0, 1, 0)), matte(0.8)),
        (shapes.quad((-0.6, 1, -1.9), (0.5, 0, 0), (0, 0.5, 0)), sv.Material(base_color=1.0, unlit=True)),
        (shapes.quad((0.6, 1.5, -1.9), (0.1, 0, 0), (0, 0.1, 0)), lamp(2.0)),
    ):
        scene.add(mesh, material)
    return scene


def measure_coat(device):
    scene, effort = coated_floor(), Effort(16, 8, 16)
    without, found = (observe(device, scene, effort, restir) for restir in (False, True))
    yield measure_mean(MEAN, found, without.mean(axis=0), 0.02, effort)


@pytest.mark.slow
def test_smooth_coats_over_rough_surfaces(device):
    """What they mirror is no light that other pixels could take."""
    require(measure_coat(device))


def observe(device, scene, effort, restir):
    """The reflected light (runs, h, w, 3) of independent runs."""
    with make_renderer(device, scene, FRAME_SIZE, lighting="paths", restir=restir) as renderer:
        return observe_runs(renderer, scene.camera, effort, add_up)


# Reservoirs keep samples for long and take them from afar, so that bugs add up.
STRESS = {"restir_confidence_cap": 30.0, "spatial_radius_halving": False, "restir_radius": 12.0}


def stressed(device):
    return measure_means(device, Effort(16, 16, 12, 4096), cornell_box(), 0.06, **STRESS)


@pytest.mark.slow
@pytest.mark.parametrize(
    "measure", [measure_means, stressed, measure_noise, measure_lag], ids=lambda measure: measure.__name__
)
def test_rules_hold(device, measure):
    require(measure(device))


RESERVOIR = "passes/paths/reservoir.glsl"
test_a_seeded_bug_is_noticed = bug_tests(
    {
        REUSED: (stressed, Bug(RESERVOIR, "is_visible", "return true;")),
        REUSED_TILES: (
            stressed,
            Bug(RESERVOIR, "shift_jacobian", "return correct(from, to, reservoir) > 0.0 ? 1.0 : 0.0;"),
        ),
        LESS_NOISE: (measure_noise, Bug(RESERVOIR, "hit_normal", "return -correct(reservoir);")),
        NO_LAG: (
            measure_lag,
            Bug(RESERVOIR, "trace_sample_transmittance", "return correct(vertex, reservoir, false);"),
        ),
        "light in a coat": (measure_coat, Bug("passes/paths/candidate.glsl", "first_ray_is_delta", "return false;")),
        "what was removed: the previous frame counts whole": (
            lambda device: test_what_was_removed_lends_no_light(device, lit_by_a_wall, "wall"),
            Bug("passes/paths/temporal.comp", "previous_confidence", "return confidence;"),
        ),
    }
)
