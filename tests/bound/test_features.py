"""Modules for scenes without features hold nothing of them; those for other scenes have them as constants."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.bound.features import FEATURES
from solari_vk.gpu.shaders.compiler import COMMON_FEATURES, compile_shader
from solari_vk.gpu.shaders.spirv import reflect
from solari_vk.gpu.shaders.spv import instructions, text

EVERY = {feature.constant for feature in FEATURES}
FEATURE = """#version 460
#include "scene/surface.glsl"
layout(local_size_x = 1) in;
layout(set = 1, binding = 0, scalar) buffer AnswerBlock { float at[]; } answer;
layout(set = 1, binding = 1, scalar) buffer GlassBlock { float at[]; } glass;
float through_glass(float cosine) { return glass.at[uint(cosine)] * refract(vec3(cosine), vec3(1.0), 1.5).x; }
void main() { FIRSTanswer.at[0] = 1.0; }
"""


def modules(path: str, **options):
    return tuple(reflect(compile_shader(path, features=features, **options), path) for features in (False, True))


OF_FEATURES = {
    "evaluate_coat",
    "prepare_glass",
    "film_fresnel",
    "sample_wavelength",
    "environment_radiance",
    "intersect_sphere",
    "intersect_portal_plane",
}


def functions(module) -> set[str]:
    """The names of the functions of a module."""
    named = {int(words[1]): text(words[2:]) for words in instructions(module.spirv) if words[0] & 0xFFFF == 5}
    return {named[int(words[2])].partition("(")[0] for words in instructions(module.spirv) if words[0] & 0xFFFF == 54}


@pytest.mark.parametrize("path", ["passes/reference/finish.comp", "passes/paths/later_rays.comp"])
def test_modules_of_scenes_without_features_have_no_code_of_them(path):
    """Their descriptors too: what only features read, such as an environment's tables, isn't bound."""
    plain, every = modules(path)
    assert EVERY & set(plain.constants) == COMMON_FEATURES
    assert len(EVERY & set(every.constants)) > 6
    assert set(plain.bindings) < set(every.bindings)
    assert functions(plain) < functions(every) - OF_FEATURES
    assert functions(every) > OF_FEATURES
    assert plain.main.writes == every.main.writes


def test_a_feature_costs_nothing_in_scenes_without_features(tmp_path: Path):
    """The module without features is the same whether or not the source has a feature's code."""
    found = {}
    for name, first in (("without", ""), ("with", "if (SCENE_GLASS) { answer.at[1] = through_glass(answer.at[2]); } ")):
        (tmp_path / f"{name}.comp").write_text(FEATURE.replace("FIRST", first))
        found[name] = modules(f"{name}.comp", root=tmp_path)
    code = [sorted(int(words[0]) for words in instructions(plain.spirv)) for plain, _ in found.values()]
    assert code[0] == code[1], "the same instructions; declarations are in another order and ids have other numbers"
    one, other = modules("passes/display/show.comp")
    assert one.spirv == other.spirv, "a shader without features has one module"
    assert set(found["with"][1].bindings) - set(found["without"][1].bindings) == {"glass"}


def test_pictures_of_both_modules_are_the_same(device):
    """Another lamp, with a tree over both, and a point light change the shaders, which stay so when they are gone."""
    scene = sv.builtin("cornell_box")
    with sv.PathTracer(device, scene, (24, 16), max_bounces=3) as tracer:
        expected, features = tracer.render(samples=4)["radiance"], {"SCENE_LIGHT_TREE", "SCENE_LIGHT_STRATA"}
        assert not tracer.binder.features
        for light in (copy.copy(scene.instances[-1]), sv.PointLight((0, 1, 0), intensity=1)):
            scene.add(light)
            tracer.render(samples=1)
            assert tracer.binder.features == features
            scene.remove(light)
            tracer.render(samples=1)
            np.testing.assert_array_equal(tracer.render(samples=4)["radiance"], expected)
            features |= {"SCENE_POINT"}


def test_edits_bring_features_of_geometry(device):
    """A flat mesh whose normals become smooth, and a small instance that becomes large, are traced as such."""
    quad = sv.shapes.quad((0, 0, 0), (1, 0, 0), (0, 0, -1))
    scene = sv.Scene(sv.DirectionalLight((0, -1, 0)))
    instance = scene.add(quad, sv.Material())
    with sv.PathTracer(device, scene, (8, 8)) as tracer:
        tracer.render(samples=1)
        assert not tracer.binder.features
        quad.normals = quad.normals + quad.positions
        tracer.render(samples=1)
        assert tracer.binder.features == {"SCENE_SMOOTH_NORMALS"}
        instance.scale = 60.0
        tracer.render(samples=1)
        assert tracer.binder.features == {"SCENE_SMOOTH_NORMALS", "SCENE_LARGE"}


def test_worlds_bring_large_instances(device):
    scene = sv.Scene(sv.DirectionalLight((0, -1, 0)))
    block = scene.add(sv.shapes.box(), sv.Material())
    transforms = np.tile(np.eye(4), (2, 1, 1))
    with sv.Batch(device, scene, (8, 8), 2, worlds=2, outputs=["depth"]) as batch:
        for scale, features in ((1, set()), (200, {"SCENE_LARGE"})):
            transforms[1, :3, :3] = scale * np.eye(3)
            batch.transforms[block] = transforms
            batch.render([np.eye(4)] * 2, fov=50)
            assert batch.binder.features == features
