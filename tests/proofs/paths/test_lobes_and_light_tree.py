"""The rules of conformance about the lobes of paths and about the light tree can fail: a seeded bug for each."""

from __future__ import annotations

from pathlib import Path

import light_tree_checks
import lobe_checks
import pytest
from light_tree_checks import CLOSE, EQUAL, OFTEN, SUM
from lobe_checks import (
    CHAIN,
    DEMODULATION,
    DISTANCE,
    LOBES,
    METAL,
    MIRROR_DISTANCE,
    MIRRORS,
    OWN_DISTANCE,
    measure_distances,
    measure_mirror_chain,
    measure_mirrors,
)
from support.measured import hold
from support.seeded_bugs import Bug, bug_tests

from solari_vk.conformance.shader_runner import ShaderRunner

ROOT = Path(__file__).parent / "glsl"


def measure_lobes(device):
    with ShaderRunner(device, ROOT) as shaders:
        yield from lobe_checks.measure_lobes(device, shaders)


def measure_tree(device):
    with ShaderRunner(device, ROOT) as shaders:
        yield from light_tree_checks.measure_tree(shaders)


@pytest.mark.parametrize("measure", [
    measure_mirrors, measure_tree,
    *(pytest.param(m, marks=pytest.mark.slow) for m in (measure_mirror_chain, measure_distances, measure_lobes)),
])  # fmt: skip
def test_rules_hold(device, measure):
    hold(measure(device))


def writing(change):
    """A bug in what the first ray writes of a pixel, of which `w` is the ray's length for the lobe that proposed it."""
    return Bug("passes/paths/first_ray.comp", "main", "correct(); uvec2 at = INVOCATION_INDEX; "
               "if (any(greaterThanEqual(at, camera.size))) { return; } uint row = at.y * camera.size.x + at.x; "
               f"vec2 lengths = vec2(paths_diffuse.at[row].w, paths_specular.at[row].w); {change} "
               "paths_diffuse.at[row].w = lengths.x; paths_specular.at[row].w = lengths.y;")  # fmt: skip


PATH, TREE = "passes/paths/path.glsl", "scene/lights/tree.glsl"
test_a_seeded_bug_is_noticed = bug_tests({
    METAL: (measure_mirrors, Bug(PATH, "lobe_weights", "if (next.pdf == INFINITY) { return LobeRadiance(next.weight, "
                                 "vec3(0.0)); } return correct(vertex, next);")),
    MIRRORS: (measure_mirrors, Bug("scene/walk.glsl", "MAX_MIRRORS", "0u")),
    CHAIN: (measure_mirror_chain, Bug("passes/paths/path_state.glsl", "load_path_state",
                                      "Path path = correct(pixel_index); path.mirrors = 0u; return path;")),
    MIRROR_DISTANCE: (measure_mirrors, writing("lengths = lengths.yx;")),
    LOBES: (measure_lobes, Bug(PATH, "path_light", "LobeRadiance light = correct(path); "
                               "light.diffuse += light.specular; return light;")),
    # demodulated by the other lobe
    DEMODULATION: (measure_lobes, Bug("passes/paths/demodulation.glsl", "demodulation",
                                      "Demodulation by = correct(surface); by.specular = by.diffuse; return by;")),
    DISTANCE: (measure_distances, writing("lengths *= 1.1;")),
    OWN_DISTANCE: (measure_distances, writing("lengths = vec2(max(lengths.x, lengths.y));")),
    EQUAL: (measure_tree, Bug(TREE, "descend_light_tree", "ChosenLight chosen = correct(receiver, rng); "
                              "chosen.probability = sqrt(chosen.probability); return chosen;")),
    SUM: (measure_tree, Bug(TREE, "leaf_probability", "return sqrt(correct(node, receiver));")),
    # the more likely of two lights is taken
    OFTEN: (measure_tree, Bug(TREE, "choose_light", "ChosenLight one = correct(receiver, rng), other = "
                              "correct(receiver, rng); return one.probability > other.probability ? one : other;")),
    CLOSE: (measure_tree, Bug(TREE, "MIN_COSINE", "1.0")),
})  # fmt: skip
