"""With random scenes and settings, every frame is finite and no radiance is negative."""

from __future__ import annotations

import numpy as np
import pytest
from support.frames import light_outputs, make_renderer
from support.scenes import random_items
from support.seeded_bugs import Bug, bug_tests, seeded

import solari_vk as sv
from solari_vk.settings import DEFAULTS, FIELDS

GUIDES = ("normal_roughness", "diffuse_albedo", "specular_albedo", "depth", "motion", "specular_motion")
OTHERS = ("gbuffer_depth", "motion_vectors", *(f"guides_{name}" for name in GUIDES))
FEW = {"light_tile_count": 4, "light_tile_samples": 64, "world_cache_cells": 1 << 12}
QUICK_COUNT, COUNT = 24, 1000


# Upper limits of settings that cost time.
MAX_VALUES = {
    "di_candidates": 64,
    "world_cache_candidates": 64,
    "world_cache_search_steps": 16,
    "specular_bounces": 12,
    "paths_bounces": 12,
    "paths_candidates": 64,
    "paths_later_candidates": 64,
}


def random_settings(random, settings):
    """Set each live setting to its default or to a random value of its whole range."""
    for name, field in FIELDS.items():
        if field.rebuilds:
            continue
        value = random_value(random, name) if random.random() < 0.35 else DEFAULTS[name]
        if getattr(settings, name) != value:
            setattr(settings, name, value)


def random_value(random, name):
    """A value of a setting's range, evenly over its orders of magnitude."""
    field, default = FIELDS[name], DEFAULTS[name]
    if field.choices:
        return str(random.choice(field.choices))
    if isinstance(default, bool):
        return not default
    high = min(field.high, MAX_VALUES.get(name, 1e6))
    low = max(field.low, 1e-6)
    value = float(np.clip(np.exp(random.uniform(np.log(low), np.log(high))), low, high))
    return round(value) if isinstance(default, int) else value


def check(renderer, frame, what):
    lights = light_outputs(frame)
    for name in (*lights, *OTHERS):
        values = np.asarray(frame[name], np.float64)
        if name.startswith("paths_"):
            values = values[..., :3]  # the distance of a ray that met nothing is infinite
        assert np.isfinite(values).all(), f"{what}: {name} is not finite in {np.argwhere(~np.isfinite(values))[:3]}"
        assert name not in lights or (values >= 0).all(), f"{what}: {name} is negative, {values.min()}"


def run(device, numbers, **built_in):
    """Check one random combination of scene and settings per number, all in one renderer. Two of three combinations
    start with a reset, the others keep the history."""
    scene = sv.Scene()
    for number in numbers:  # all at once first, so that shaders with their features are compiled once
        for item in random_items(np.random.default_rng(number))[:-1]:
            scene.add(item)
    with make_renderer(device, scene, (8, 8), **FEW, **built_in) as renderer:
        for number in numbers:
            random = np.random.default_rng(number)
            if number % 12 == 0:
                renderer.resize(tuple(int(n) for n in random.integers(8, 17, 2)))
            if number % 3:
                renderer.reset()
            *items, camera = random_items(random)
            for item in (*scene.instances, *scene.lights):
                scene.remove(item)
            for item in items:
                scene.add(item)
            random_settings(random, renderer.settings)
            for _ in range(3):
                renderer.render(camera)
            for item in list(scene.instances)[:1]:
                item.transform = item.transform @ np.diag((1.01, 1, 1, 1))
            check(renderer, renderer.render(camera), f"combination {number}")


def test_frames_are_finite(device):
    run(device, range(QUICK_COUNT))


@pytest.mark.slow  # takes minutes: each way to build a renderer compiles its own pipelines
@pytest.mark.parametrize(
    "built_in",
    [
        {"lighting": "split"},
        {"restir": True},
        {"gbuffer": "traced"},
        {"occlusion_culling": False},
        {"layering": "fresnel_product", "frustum_culling": False},
        {"lambert": True, "gbuffer": "traced"},
    ],
    ids=str,
)
def test_frames_are_finite_however_they_are_built(device, built_in):
    run(device, range(COUNT, COUNT + 50), **built_in)


@pytest.mark.slow
def test_a_search_without_neighbor_adds_nothing(device):
    """The surface of a neighbor that wasn't found holds what a register held before, here NaN."""
    poison = Bug(
        "passes/reuse.glsl",
        "find_spatial_neighbor",
        "bool found = correct(pixel, surface, radius, rng, neighbor, neighbor_surface); "
        "if (!found) { neighbor_surface = surface; "
        "neighbor_surface.material.base.metallic = uintBitsToFloat(0x7FC00000u); } return found;",
    )
    with (
        seeded(poison),
        make_renderer(device, sv.builtin("cornell_box"), (16, 12), restir=True, spatial_tries=1) as renderer,
    ):
        for _ in range(8):
            assert np.isfinite(renderer.render()["radiance"]).all()


@pytest.mark.slow  # takes minutes
def test_a_thousand_combinations_are_finite(device):
    run(device, range(QUICK_COUNT, COUNT))


test_a_seeded_bug_is_noticed = bug_tests(
    {
        "finite: a pixel divides by nothing": (
            lambda device: run(device, range(12)),
            Bug(
                "passes/display/compose.comp",
                "main",
                "correct(); if (gl_GlobalInvocationID.xy == uvec2(0u)) { "
                "diffuse_radiance.at[0] = vec3(uintBitsToFloat(0x7FC00000u)); }",
            ),
        )
    }
)
