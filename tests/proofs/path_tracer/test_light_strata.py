"""The path tracer samples each of few lights, or both the lamps and the lights at infinity, and traces one sample."""

from __future__ import annotations

import numpy as np
import pytest
from support.frames import path_traced_runs
from support.seeded_bugs import Bug, bug_tests
from support.statistics import assert_equal, compare

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, matte

SIZE = (32, 32)
SUN = sv.DirectionalLight(direction=(-1, -2, -0.5), illuminance=8, angular_diameter=1.0)
LAMPS = [(at, lamp((2, 3, 4))) for at in ((-1.5, 0.4, 0.5), (-1, 1.6, 0), (1.4, 0.5, 0.8), (0.2, 2, -0.8))]


def stage(lamps, *lights, sky=0.0):
    """A glossy ball on a gray floor."""
    scene = sv.Scene(*lights)
    scene.add(shapes.quad((0, 0, 0), (3, 0, 0), (0, 0, -3)), matte((0.6, 0.6, 0.6)))
    scene.add(shapes.sphere(0.6, 32), sv.Material(base_color=0.5, perceptual_roughness=0.4), (0, 0.6, 0))
    for at, material in lamps:
        scene.add(shapes.box((-0.15, -0.15, -0.15), (0.15, 0.15, 0.15)), material, at)
    if sky:
        scene.environment = sv.Environment(sky * np.linspace(2, 0.1, 8)[:, None, None] * np.ones((8, 16, 3)))
    scene.camera = sv.Camera.look_at((0, 1.6, 3.5), (0, 0.6, 0), vertical_fov=0.9)
    return scene


def window():
    scene = stage(LAMPS, SUN, sky=1.0)
    scene.add(sv.Portal(center=(0, 1.5, -2), half_u=(1.5, 0, 0), half_v=(0, 1, 0)))
    return scene


SCENES = {
    "one lamp, the sun and the sky": lambda: stage(LAMPS[:1], SUN, sky=1.0),
    "lamps, the sun and the sky": lambda: stage(LAMPS, SUN, sky=1.0),
    "a portal": window,
}


def test_a_dark_sky_behind_a_portal(device):
    scene = stage(LAMPS[:1])
    scene.environment = sv.Environment((1.0, 1.0, 1.0), intensity=0)
    scene.add(sv.Portal(center=(0, 1.5, -2), half_u=(1.5, 0, 0), half_v=(0, 1, 0)))
    with sv.PathTracer(device, scene, SIZE) as tracer:
        assert np.isfinite(tracer.render(samples=8)["radiance"]).all()


def check_strategies(device, name):
    """BRDF samples and light samples alone give the same picture as both: each weight has the right probability."""
    scene = SCENES[name]()
    pictures = {
        strategy: path_traced_runs(device, scene, SIZE, 128, seed=seed, max_bounces=2, light_strategy=strategy)
        for seed, strategy in enumerate(("mis", "nee", "brdf"), 3)
    }
    both = pictures["mis"]
    for strategy, bar in (("nee", 0.015), ("brdf", 0.03)):
        alone = pictures[strategy]
        result = compare(alone.mean, alone.variance, both.mean, both.variance, 8)
        print(name, strategy, result)
        assert_equal(result, bar, f"{name}: {strategy}")


@pytest.mark.parametrize("name", SCENES)
def test_light_strategies_agree(device, name):
    check_strategies(device, name)


def noise(device, *lamps):
    """The relative variance of a ball in the sun, with lamps."""
    scene = sv.Scene(SUN)
    scene.add(shapes.sphere(1.0, segments=64), sv.Material(base_color=0.7, reflectance=0))
    for at in lamps:
        scene.add(sv.PointLight(at, intensity=5.0))
    camera = sv.Camera.look_at((1.5, 1, 4), (0, 0, 0), vertical_fov=0.6)
    parts = path_traced_runs(device, scene, (24, 24), 32, camera=camera)
    ball = np.s_[8:16, 8:16]
    return float(parts.variance[ball].mean() / parts.mean[ball].mean() ** 2)


HIDDEN = [(0.1 * i, 0, 0) for i in range(8)]
BESIDE = [(3, 3, 3), (-2, 3, 4)]


def check_hidden_lamps(device, shown, hidden):
    """Lamps that send nothing to the camera's side of the ball, since they are in it, add no noise."""
    assert noise(device, *shown, *hidden) < 1.5 * noise(device, *shown) + 1e-4


@pytest.mark.parametrize(("shown", "hidden"), [((), HIDDEN[:3]), ((), HIDDEN), (BESIDE[:1], HIDDEN[:2])])
def test_hidden_lamps(device, shown, hidden):
    check_hidden_lamps(device, shown, hidden)


TREE = "scene/lights/tree.glsl"
test_a_seeded_bug_is_noticed = bug_tests(
    {
        "few lights by power": (
            lambda device: check_strategies(device, "one lamp, the sun and the sky"),
            Bug(TREE, "leaf_choice_probability", "return light_leaves.at[row].by_power.probability;"),
        ),
        "lights at infinity by power among all": (
            lambda device: check_strategies(device, "lamps, the sun and the sky"),
            Bug(
                TREE,
                "choose_leaf_at_infinity",
                "uint row = choose_leaf(rng); return ChosenLeaf(row, light_leaves.at[row].by_power.probability);",
            ),
        ),
        "one stratum": (
            lambda device: check_hidden_lamps(device, (), HIDDEN),
            Bug(TREE, "stratum_count", "return 1u;"),
        ),
    },
    quick=("one stratum",),
)
