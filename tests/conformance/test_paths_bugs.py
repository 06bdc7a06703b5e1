"""The group `paths` can fail: a seeded bug for each rule, and for each part of a path."""

from __future__ import annotations

import pytest
from seeded_bugs import expect_noticed, failing, marked, rules_broken_by, rules_of

from solari_vk.conformance import light_tree_checks, lobe_checks, paths_checks
from solari_vk.conformance.realtime import Effort
from solari_vk.conformance.shader_runner import ShaderRunner

PATH, VERTEX, TRACE, COMPOSE = (f"passes/paths/{name}" for name in ("path.glsl", "vertex.glsl", "first_ray.comp",
                                                                    "compose.comp"))  # fmt: skip
WAITING, LATER = "passes/paths/waiting.glsl", "passes/paths/later_rays.comp"
BRIEF = paths_checks.Profile(Effort(16, 0, 16, 2048), Effort(16, 16, 12), (0.03, 0.03))


def one(device):
    return paths_checks.measure_means(device, BRIEF, kinds=["one"])


def several(device):
    return paths_checks.measure_means(device, BRIEF, kinds=["several"])


def cached(device):
    return paths_checks.measure_means(device, BRIEF, kinds=["cached"])


def lobes(device):
    with ShaderRunner(device) as shaders:
        yield from lobe_checks.measure_lobes(device, shaders)


def tree(device):
    with ShaderRunner(device) as shaders:
        yield from light_tree_checks.measure_tree(shaders)


mirrors, chain, distances = (lobe_checks.measure_mirrors, lobe_checks.measure_mirror_chain,
                             lobe_checks.measure_distances)  # fmt: skip
cells, noise = paths_checks.measure_cells, paths_checks.measure_sequence
ONE, ONE_TILES, SEVERAL = (rule.name for rule in (paths_checks.ONE, paths_checks.ONE_TILES, paths_checks.SEVERAL))
SEVERAL_TILES, CACHED, TILES = (rule.name for rule in (paths_checks.SEVERAL_TILES, paths_checks.CACHED,
                                                       paths_checks.CACHED_TILES))  # fmt: skip
EQUAL, SUM, OFTEN, CLOSE = (
    rule.name for rule in (light_tree_checks.EQUAL, light_tree_checks.SUM, light_tree_checks.OFTEN,
                           light_tree_checks.CLOSE)
)  # fmt: skip
TREE = "scene/lights/tree.glsl"
CELLS, NOISE = paths_checks.CELLS.name, paths_checks.SEQUENCE.name
MIRRORS, CHAIN, LENGTH, METAL, LOBES, DEMODULATED, COSINE, OWN = (
    rule.name for rule in (lobe_checks.MIRRORS, lobe_checks.CHAIN, lobe_checks.MIRROR_DISTANCE, lobe_checks.METAL,
                           lobe_checks.LOBES, lobe_checks.DEMODULATION, lobe_checks.DISTANCE, lobe_checks.OWN_DISTANCE)
)  # fmt: skip
BUGS = {
    "light samples without MIS weight": (one, [ONE], VERTEX, "light.received_radiance * mis_weight",
                                         "light.received_radiance"),
    "hits without MIS weight": (one, [ONE, ONE_TILES], PATH,
                                "surface.material.emissive * power_heuristic(mis_pdf, light_pdf)",
                                "surface.material.emissive"),
    "no hits": (one, [ONE_TILES], PATH, "surface.material.emissive * power_heuristic(mis_pdf, light_pdf)",
                "surface.material.emissive * (next.pdf == INFINITY ? 1.0 : 0.0)"),
    "no light samples": (one, [ONE_TILES], PATH, "if (max_component(sum(drawn.light)) > 0.0) {", "if (false) {"),
    "sun's hits without MIS weight": (one, [ONE_TILES], PATH, "radiance_at_infinity(path.direction, mis_pdf)",
                                      "radiance_at_infinity(path.direction, INFINITY)"),
    "probability of light samples forgotten": (one, [ONE_TILES], PATH, "path.throughput / probability",
                                               "path.throughput"),
    "1/M dropped": (several, [SEVERAL, SEVERAL_TILES], VERTEX, "(float(candidates) * chosen_weight)", "chosen_weight"),
    "light samples weighted as one": (several, [SEVERAL_TILES], VERTEX, "power_heuristic(density * light",
                                      "power_heuristic(light"),
    "hits weighted against one light sample": (several, [SEVERAL_TILES], PATH, "? next.pdf / density : INFINITY",
                                               "? next.pdf / probability : INFINITY"),
    "first weight without pdf": (one, [ONE, ONE_TILES], PATH, "vec3(1.0 / next.pdf)) : NO_LIGHT",
                                 "vec3(1.0)) : NO_LIGHT"),
    "later weights forgotten": (one, [ONE, ONE_TILES], PATH, "path.throughput *= next.weight;", ""),
    "survivors are not raised": (one, [ONE, ONE_TILES], PATH, "    path.throughput /= survival;\n", ""),
    "roughness without leave": (one, [ONE_TILES], VERTEX, " * paths_settings.regularization;", ";"),
    "light samples without shadow": (one, [ONE, ONE_TILES], PATH,
                                     "= trace_light_transmittance(from, drawn.light_sample);",
                                     "= vec3(1.0);"),
    "only the first light sample": (one, [ONE, ONE_TILES], PATH,
                                    "if (transmittance != vec3(0.0)) {",
                                    "if (first && transmittance != vec3(0.0)) {"),
    "cache without 1/pi": (cached, [CACHED, TILES], PATH, "(INVERSE_PI * cached.irradiance)", "cached.irradiance"),
    "survivors of the cache are not raised": (cached, [CACHED], PATH, "    path.throughput /= share;\n", ""),
    "specular lobe in the cache and followed": (cached, [CACHED], PATH, "(rough ? albedos.specular : vec3(0.0))",
                                                "albedos.specular"),
    "diffuse lobe in the cache and followed": (
        cached, [CACHED], PATH, "path.reflects_only = true;", ""),
    "waiting paths forget what the cache stands for": (cached, [CACHED], WAITING,
                                                       "(waiting.state & REFLECTS_ONLY) != 0u", "false"),
    "waiting paths forget their throughput": (one, [ONE, ONE_TILES], WAITING, "= waiting.throughput;", "= vec3(1.0);"),
    "waiting paths forget their mirrors": (chain, [CHAIN], WAITING, "waiting.state >> 8u & 0xFFu", "0u"),
    "no second round": (one, [ONE, ONE_TILES], LATER, "if (goes_on) { wait", "if (false) { wait"),
    "the last round is a single ray": (chain, [CHAIN], LATER, "while (goes_on &&", "while (false &&"),
    "cells without pi": (cells, [CELLS], "passes/world_cache/sample.comp", "PI * path_light", "path_light"),
    "cells follow no specular lobe": (cells, [CELLS], PATH, "if (rough || !(rand_f(path.rng) < share)) {",
                                      "if (true) {"),
    "distances swapped": (mirrors, [LENGTH], TRACE, "path.diffuse_first ? vec2", "!path.diffuse_first ? vec2"),
    "distances from the origin": (distances, [COSINE], TRACE, "vec2(path.hit.t, 0.0)",
                                  "vec2(length(path.vertex.origin), 0.0)"),
    "one distance for both lobes": (distances, [OWN], TRACE, ": vec2(0.0, path", ": vec2(path.hit.t, path"),
    "mirrors count as bounces": (mirrors, [MIRRORS], PATH, "next.pdf == INFINITY && path.mirrors <",
                                 "false && path.mirrors <"),
    "no Fresnel in the first mirror": (mirrors, [MIRRORS], PATH, "return Lobes(vec3(0.0), next.weight);",
                                       "return Lobes(vec3(0.0), vec3(1.0));"),
    "mirrors reflect by the diffuse lobe": (mirrors, [METAL], PATH, "return Lobes(vec3(0.0), next.weight);",
                                            "return Lobes(next.weight, vec3(0.0));"),
    "lobes swapped": (lobes, [LOBES], TRACE, "light.diffuse / by.diffuse",
                      "light.specular / by.diffuse"),
    "both lobes in one": (lobes, [LOBES], PATH, "Lobes(direct.diffuse + indirect.diffuse",
                          "Lobes(direct.diffuse + sum(indirect)"),
    "demodulation not undone": (lobes, [LOBES, DEMODULATED], COMPOSE, "paths_diffuse.at[index].rgb * by.diffuse",
                                "paths_diffuse.at[index].rgb * max(by.diffuse, vec3(1.0))"),
    "demodulated by the other lobe": (lobes, [DEMODULATED], "passes/paths/demodulation.glsl",
                                      "vec3(1.0), albedos.specular)", "vec3(1.0), albedos.diffuse)"),
    "a sibling's probability": (tree, [EQUAL, SUM], TREE, "own = child == node ?", "own = child == first ?"),
    "walk that ends at the first level": (tree, [EQUAL, SUM], TREE, "        node = parent;", "        node = 0u;"),
    "lights at infinity forgotten": (tree, [EQUAL, SUM], TREE, "return scene_info.finite_probability * leaf",
                                     "return leaf"),
    "children not by importance": (tree, [OFTEN], TREE, "choose_weighted(sum, child_importance, rng)",
                                   "0.9 * rand_f(rng) * (sum += child_importance) < child_importance"),
    "tree without power": (tree, [CLOSE], TREE, "node.power * inverse *", "inverse *"),
    "tree by distance, not squared": (tree, [CLOSE], TREE,
                                      "inversesqrt(squared) * inversesqrt(nearest_squared)", "inversesqrt(squared)"),
    "tree without cosine": (tree, [CLOSE], TREE, "clamp(height * sqrt(inverse), MIN_COSINE, 1.0)", "1.0"),
    "hits of hardly likely lights": (one, [ONE_TILES], VERTEX,
                                   "light_choice_probability(light, receiver(vertex))", "0.02"),
    "random directions": (noise, [NOISE], TRACE, "sobol_point(this_frame.index, sequence + 1u)",
                          "rand_vec2f(path.rng)"),
    "a sequence for each frame": (noise, [NOISE], TRACE, "uint sequence = seed_rng(pixel, 0u,",
                                  "uint sequence = seed_rng(pixel, this_frame.index,"),
}  # fmt: skip

QUICK = ("light samples without MIS weight", "mirrors count as bounces", "distances swapped", "demodulation not undone",
         "a sequence for each frame", "a sibling's probability", "tree without cosine")  # fmt: skip
MODULES = paths_checks, lobe_checks, light_tree_checks


@pytest.mark.parametrize("module", MODULES, ids=lambda module: module.__name__.split(".")[-1])
def test_every_rule_has_a_bug(module):
    """Each Rule that is a constant of its module has a seeded bug that makes it fail."""
    rules = rules_of(module)
    assert rules
    assert not rules - rules_broken_by(BUGS)


@pytest.mark.parametrize("name", marked(BUGS, QUICK))
def test_bug_is_noticed(device, name):
    expect_noticed(device, BUGS[name])


@pytest.mark.slow
@pytest.mark.parametrize("measure", [one, several, cached])
def test_brief_check_holds_without_a_bug(device, measure):
    """The control of the bugs: with less effort than the suite takes, correct shaders pass."""
    assert not failing(measure(device))
