"""The rules of the groups lights and path_tracer fail with seeded bugs; tests/glsl has those of the group brdf."""

from __future__ import annotations

from seeded_bugs import expect_red

from solari_vk.conformance import light_checks, path_checks
from solari_vk.gpu.shaders.patches import patched_shaders


def test_bugs_in_lights_are_noticed(device):
    """Light samples get a wrong density."""
    bug = ("scene/sampling.glsl", "? 1.0 / probability", "? 1.0 + 1.0 / probability")
    with patched_shaders(bug):
        expect_red(light_checks.measure_lamp(device, "nee"), "floor, nee: mean", "floor, nee: tiles")
        expect_red(light_checks.measure_sun(device, 0.0093, "nee"), "nee: mean")
        expect_red(light_checks.measure_invariance(device), "in two parts")


def test_bugs_in_the_choice_of_triangles_are_noticed(device):
    """Samples, or hits, take all triangles of a textured lamp for equally likely."""
    every = "return has_equal_parts(light) ? 1.0 /", "return true ? 1.0 /"
    with patched_shaders(("scene/lights/choice.glsl", *every)):
        expect_red(light_checks.measure_textured_lamp(device, "nee"), "spot over a floor, nee: mean")
    hits = "light_sources.at[instance.light_index], hit.triangle)", "light_sources.at[instance.light_index], 0u)"
    with patched_shaders(("scene/surface.glsl", *hits)):
        expect_red(light_checks.measure_textured_lamp(device, "mis"), "spot over a floor, mis: mean")


def test_a_small_bias_of_light_samples_is_noticed(device):
    """Light samples are 2 % too bright."""
    bug = ("scene/sampling.glsl", "? 1.0 / probability", "? 1.02 / probability")
    with patched_shaders(bug):
        expect_red(path_checks.measure_series(device, 1, ["nee"]), "after 1 bounces, nee")


def test_bugs_in_the_path_tracer_are_noticed(device):
    """Roulette's survivors keep their throughput, and rays start without an offset."""
    bugs = [
        ("passes/pathtracer/trace.comp", "throughput /= survival;", ""),
        ("scene/surface.glsl", "16.0 * ROUNDING_UNIT * dot(world_reach", "0.0 * dot(world_reach"),
    ]
    with patched_shaders(*bugs):
        expect_red(path_checks.measure_series(device, 5, ["mis"]), "after 5 bounces, mis")
        expect_red(path_checks.measure_light_tight(device, ["far"]), "light-tight, far")


def test_seeds_without_effect_are_noticed(device, monkeypatch):
    take = path_checks.take_picture
    monkeypatch.setattr(path_checks, "take_picture", lambda *a, seed, **options: take(*a, seed=0, **options))
    expect_red(path_checks.measure_seeds(device), "another seed")
