"""The mean of whole frames against the path tracer, over independent runs: no light is lost, added or leaked."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.frames import (
    JITTER_PERIOD,
    SPLIT_LIGHTING,
    TILES,
    WHOLE,
    Effort,
    add_up,
    denoised_first,
    make_renderer,
    measure_frames,
    observe_runs,
    path_traced_reflected,
    render_frames,
)
from support.seeded_bugs import Bug, bug_tests, require
from support.statistics import measure_mean, measure_picture_tiles, tile_means_4x4

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import closed_box, cornell_box, lamp, rgb

# Perceptual roughness, metallic, and pixels per side: enough pixels that the interval is half of the bar. More frames
# would hardly narrow it, because the frames of a run share the cache's noise.
BOXES = {
    "matte": (1.0, 0.0, 32),
    "mirror": (0.0, 1.0, 16),
    "plastic": (0.3, 0.0, 32),
    "rough metal": (0.7, 1.0, 32),
    "glossy metal": (0.3, 1.0, 32),
}
BRIEF = Effort(16, 20, 12, 128)


def measure_closed_box(device, walls, effort, **settings):
    """Walls emit 1 and reflect half of the light: frames are as bright as the path tracer's, also in each tile."""
    scene = closed_box()
    roughness, metallic, side = BOXES[walls]
    material = next(iter(scene)).material
    material.update(perceptual_roughness=roughness, metallic=metallic)
    if walls != "matte":
        material.reflectance = rgb(0.5)
    samples = effort.samples * 32**2 // side**2
    # The bar of tiles is four standard errors of the noisiest tile of matte walls.
    yield from measure_frames(device, scene, effort, samples, 0.03, 0.1, (side, side), **settings)


def measure_light(device, effort, bar=0.02, tile_bar=0.05, **settings):
    """The Cornell box's light in pixels without a visible lamp."""
    scene = cornell_box()
    expected = path_traced_reflected(device, scene, effort.samples)
    shown = (expected > 0).any(axis=-1, keepdims=True)
    with make_renderer(device, scene, **settings) as renderer:
        found = observe_runs(renderer, scene.camera, effort, add_up) * shown
    yield measure_mean(WHOLE, found, expected, bar, effort)
    yield measure_picture_tiles(TILES, found, expected, tile_bar, effort)


def check_lights_off(device, name="cornell_box", **settings):
    """Ten frames after all lamps were switched off little light is left, and after twenty almost none."""
    scene = sv.builtin(name)
    with make_renderer(device, scene, **settings) as renderer:
        render_frames(renderer, scene.camera, 20)
        lit = np.mean([add_up(renderer.render(scene.camera)).mean() for _ in range(4)])
        for instance in scene:
            instance.material.emissive = 0.0
        left = [add_up(renderer.render(scene.camera)).mean() / lit for _ in range(20)]
    print(np.round(left, 4))
    assert left[9] < 0.05
    assert left[19] < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("settings", [{}, SPLIT_LIGHTING], ids=["paths", "split"])
def test_light_of_a_cornell_box(device, settings):
    require(measure_light(device, Effort(12, samples=2048), **settings))


@denoised_first
@pytest.mark.parametrize("name", ["cornell_box", pytest.param("sphere_grid", marks=pytest.mark.slow)])  # many cells
def test_lights_off(device, name, lighting):
    check_lights_off(device, name, **lighting)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "effort"), [({}, Effort(16, 24, JITTER_PERIOD, 512)), (SPLIT_LIGHTING, BRIEF)], ids=["paths", "split"]
)
@pytest.mark.parametrize("walls", ["matte", "mirror"])
def test_energy_is_kept_in_a_closed_box(device, walls, settings, effort):
    require(measure_closed_box(device, walls, effort, **settings))


@pytest.mark.slow  # these walls, close to lights, have noise with heavy tails
@denoised_first
@pytest.mark.parametrize("walls", ["plastic", "rough metal", "glossy metal"])
def test_energy_is_kept_in_a_closed_glossy_box(device, walls, lighting):
    require(measure_closed_box(device, walls, Effort(16, 24, 24, 256), **lighting))


def ball_in_white(perceptual_roughness, metallic):
    """A white ball in a black sphere that glows with radiance 1: nothing of the picture may differ from 1."""
    sky = sv.Instance(shapes.sphere(8.0, 24), lamp(1.0, double_sided=True), name="white")
    white = sv.Material(base_color=rgb(1), perceptual_roughness=perceptual_roughness, metallic=metallic)
    ball = sv.Instance(shapes.sphere(1.0, 96), white, name="ball")
    return sv.Scene(sky, ball, sv.Camera.look_at((0, 0, 6), (0, 0, 0), vertical_fov=2 * math.asin(1.02 / 6)))


def of_ball(frame):
    """The mean radiance (3,) of the pixels whose surface doesn't emit."""
    return frame["radiance"][~frame["emission"][..., :3].any(axis=-1)].mean(axis=0)


# Perceptual roughness and metallic of a ball, the number of runs, the frames of each run, and the bar. Mirrors need few
# frames, because each of their rays has the white sky's radiance.
BALLS = {
    "mirror": (0.0, 1.0, 4, 8, 1e-3),
    "smooth metal": (0.1, 1.0, 8, 16, 2e-3),
    "matte": (1.0, 0.0, 16, 16, 0.03),
    "plastic": (0.4, 0.0, 16, 16, 0.03),
    "lacquer": (0.0, 0.0, 16, 16, 0.03),
    "rough metal": (0.8, 1.0, 16, 16, 0.03),
}


@denoised_first
@pytest.mark.parametrize(
    "ball", [pytest.param(name, marks=[] if name == "mirror" else [pytest.mark.slow]) for name in BALLS]
)
def test_white_furnace(device, ball, lighting):
    """A white ball has the radiance of the white sky around it: the frame neither adds nor loses light."""
    roughness, metallic, runs, observed, bar = BALLS[ball]
    observed *= 4 if lighting.get("restir") or "lighting" in lighting else 1  # reuse makes frames correlated
    scene, effort = ball_in_white(roughness, metallic), Effort(runs, 24, observed)
    with make_renderer(device, scene, world_cache_cell_size=4.0, **lighting) as renderer:
        found = observe_runs(renderer, scene.camera, effort, of_ball)
    require([measure_mean(WHOLE, found, 1.0, bar, effort)])


@pytest.mark.slow  # takes over a minute of processor time: tens of thousands of cells and three million paths
@denoised_first
@pytest.mark.parametrize("name", ["sphere_grid", "mirror_hall"])
def test_glossy_scenes(device, name, lighting):
    """The denoiser gets a larger picture: it blurs the light of what is few pixels wide."""
    size, runs = ((96, 96), 4) if lighting.get("denoise") else ((32, 32), 16)
    scene, effort = sv.builtin(name), Effort(runs, 24, 12)
    require(measure_frames(device, scene, effort, 512, 0.05, 0.12, size, **lighting))


@pytest.mark.slow
@denoised_first
def test_an_overfull_cache_shows_no_patches(device, lighting):
    """With more cells than the map holds, no tile loses its light, and no light is added."""
    scene, size = cornell_box(), (64, 64)
    expected = path_traced_reflected(device, scene, 256, size)
    cells = sv.Settings().world_cache_cells
    with make_renderer(
        device,
        scene,
        size,
        **lighting,
        world_cache_cells=cells,
        world_cache_cell_size=0.001,
        world_cache_update_cap=cells,
        world_cache_lifetime=100,
    ) as renderer:
        for _ in range(16):
            renderer.render(scene.camera)
        assert np.mean(renderer["world_cache_life"] > 0) > 0.9
        assert renderer["world_cache/insert_failures"] > 1000
        picture = np.mean([add_up(renderer.render(scene.camera)) for _ in range(4)], axis=0)
    picture[(expected == 0).all(axis=-1)] = 0
    there = tile_means_4x4(expected).mean(axis=-1) > 0
    ratio = tile_means_4x4(picture).mean(axis=-1)[there] / tile_means_4x4(expected).mean(axis=-1)[there]
    assert np.isfinite(picture).all()
    assert ratio.min() > 0.8, "a patch of the picture lost its light"
    assert 0.9 < picture.mean() / expected.mean() < 1.05


def composing(change):
    """A bug in the last pass of paths, for each pixel at `at`."""
    return Bug(
        "passes/display/compose.comp",
        "main",
        "correct(); uvec2 at = gl_GlobalInvocationID.xy; "
        "if (any(greaterThanEqual(at, camera.size))) { return; } "
        f"uint row = at.y * camera.size.x + at.x; {change}",
    )


def brief(device):
    return measure_light(device, Effort(8, 16, 16, 1024), 0.04, 0.1)


@pytest.mark.slow
def test_brief_check_holds(device):
    require(brief(device))


test_a_seeded_bug_is_noticed = bug_tests(
    {
        WHOLE: (brief, composing("diffuse_radiance.at[row] *= 1.08;")),
        TILES: (brief, composing("if (all(lessThan(4u * at, camera.size))) { diffuse_radiance.at[row] *= 0.5; }")),
        "lights off": (
            check_lights_off,
            composing("diffuse_radiance.at[row] = max(diffuse_radiance.at[row], vec3(0.03));"),
        ),
    }
)
