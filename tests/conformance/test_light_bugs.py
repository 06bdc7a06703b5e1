"""The groups brdf, lights and path_tracer can fail."""

from __future__ import annotations

from seeded_bugs import expect_red

from solari_vk.conformance import brdf_checks, light_checks, path_checks
from solari_vk.gpu.shaders.patches import patched_shaders


def test_bugs_in_the_brdf_are_noticed(patched):
    """Energy lost, a density without its Jacobian, a value that isn't reciprocal: one shader holds them all."""
    bugs = [
        ("scene/brdf.glsl", "brdf.multiscatter = 1.0 / (ab.x + ab.y) - 1.0", "brdf.multiscatter = 0.0"),
        ("scene/microfacet.glsl", "return 0.5 / (k", "return 1.0 / (k"),
        ("scene/brdf.glsl", "(1.0 - specular_albedo(brdf.dielectric_f0, ab))", "1.0"),
    ]
    with patched(*bugs) as shaders:
        expect_red(brdf_checks.measure_furnace(shaders, 1.0), "white furnace")
        expect_red(brdf_checks.measure_draws(shaders, [(0.5, 1.0, 60.0)], 50_000), "draws follow")
        expect_red(brdf_checks.measure_numbers(shaders, 20_000), "diffuse is reciprocal")


def test_bugs_in_lights_are_noticed(device):
    """A light's chance mistold."""
    bug = ("scene/sampling.glsl", "float inverse_light_pdf = float(", "float inverse_light_pdf = 1.0 + float(")
    with patched_shaders(bug):
        expect_red(light_checks.measure_lamp(device, "nee"), "floor, nee: mean", "floor, nee: tiles")
        expect_red(light_checks.measure_sun(device, 0.0093, "nee"), "nee: mean")
        expect_red(light_checks.measure_invariance(device), "in two parts")


def test_bugs_in_the_path_tracer_are_noticed(device):
    """Survivors' energy kept down, and rays that start where they are."""
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
