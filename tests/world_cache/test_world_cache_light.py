"""What the world cache holds against closed forms, lifetimes, overfull maps, determinism; and seeded bugs."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from oracles.replication import relative_interval
from world_cache_frame import SHADERS, CacheFrame

import solari_vk as sv
from solari_vk.gpu.frame import Frame, Pass, Stage
from solari_vk.passes import brdf_table

ALBEDO = 0.5  # of closed_box, whose walls emit 1: so 2 arrives everywhere, and of it 1 is reflected
CASE = np.dtype([("base_color", "f4", 3), ("reflectance", "f4"), ("perceptual_roughness", "f4"), ("metallic", "f4"),
                 ("cosine", "f4")])  # fmt: skip


def settings(**changed):
    return sv.Settings(**{"lambert": True, "world_cache_cells": 1 << 14, "world_cache_search_steps": 16, **changed})


def check_fixed_point(device, root=None, *, seeds=16, bar=0.02, warm_up=40, **changed):
    """Answers are what a closed box reflects, from replicated runs: the 95 % interval lies inside the bar."""
    with CacheFrame(device, sv.builtin("closed_box", size=4.0), settings(**changed), glsl_root=root) as frame:
        observations = []
        for seed in range(seeds):
            frame.reset(seed)
            frame.run(warm_up)
            observations.append(np.mean([frame.run()["answers"].mean() for _ in range(4)]))
    error, half_width = relative_interval(np.array(observations), ALBEDO * 1 / (1 - ALBEDO))
    assert abs(error) + half_width < bar, (error, half_width)


def test_fixed_point(device):
    """A mean over few frames gets there sooner, and where it gets does not hang on how many."""
    check_fixed_point(device, warm_up=24, world_cache_blend="fixed", world_cache_max_samples=6)


@pytest.mark.slow
def test_fixed_point_as_shipped(device):
    """The adaptive blend forgets the brightest samples sooner than the others: about 1 % is lost here."""
    check_fixed_point(device, warm_up=100)


def test_without_the_cache_there_is_one_bounce(device):
    """No cells, and what a single light sample gives: half of what the walls emit."""
    with CacheFrame(device, sv.builtin("closed_box"), settings(world_cache=False)) as frame:
        answers = np.concatenate([frame.run()["answers"][:, 0] for _ in range(8)])
        assert frame.counters == {"active_cells": 0, "updates": 0, "insert_failures": 0}
        assert not frame["checksums"].any()
    error = answers.std() / np.sqrt(len(answers))
    assert abs(answers.mean() - ALBEDO) < 4 * error < 0.2


@pytest.mark.parametrize("rule", ["max", "store"])
def test_cells_die_when_nobody_asks(device, rule):
    """Under the rule `max` after their lifetime, although they go on asking each other; under `store` never."""
    with CacheFrame(device, sv.builtin("closed_box"), settings(world_cache_lifetime_rule=rule)) as frame:
        frame.run(12)
        assert frame.counters["active_cells"] > 1000
        frame.settings.gi = False
        frame.run(10)
        assert frame.counters["active_cells"] > 1000, "cells died before their time"
        frame.run(1 if rule == "max" else 30)
        assert (frame.counters["active_cells"] == 0) == (rule == "max")


def test_an_overfull_map_loses_no_light(device):
    """A fifth of the places that are asked for: paths go on where the cache has none."""
    check_overfull(device)


def check_overfull(device, root=None):
    few = settings(world_cache_cells=1 << 10, world_cache_search_steps=3)
    with CacheFrame(device, sv.builtin("closed_box", size=4.0), few, glsl_root=root) as frame:
        frame.run(40)
        answers = np.concatenate([frame.run()["answers"][:, 0] for _ in range(16)])
        assert frame.counters["insert_failures"] > 100
        assert frame.counters["active_cells"] > 1000
    assert np.isfinite(answers).all()
    assert (answers > 0).mean() > 0.9, "more than light samples on the same wall"
    assert abs(answers.mean() - 2 * ALBEDO) < 0.06, "a path of unknown hits ends some time"


def test_one_seed_one_cache(device):
    """The cells of two runs are alike bit by bit, also with a barrier before every pass; another seed's are not."""
    runs = []
    for seed, barriers in ((0, False), (0, True), (1, False)):
        scene = sv.builtin("cornell_box")
        camera = sv.Camera.look_at((0.0, 1.0, 0.2), (0, 1, -1))
        with CacheFrame(device, scene, settings(lambert=False, world_cache_update_cap=500), seed=seed,
                        barriers=barriers) as frame:  # fmt: skip
            frame.run(12, camera)
            assert frame.counters["insert_failures"] == 0
            assert frame.counters["updates"] < frame.counters["active_cells"]
            runs.append(frame.cells() | {"answers": frame["answers"]})
    for name, values in runs[0].items():
        np.testing.assert_array_equal(values, runs[1][name], err_msg=name)
    assert not np.array_equal(runs[0]["answers"], runs[2]["answers"])


@pytest.mark.parametrize("layering", ["conserving", "sum", "fresnel_product"])
def test_albedo_is_what_the_brdf_reflects(device, layering):
    check_albedo(device, layering=layering)


def check_albedo(device, root=None, layering="conserving"):
    grid = np.array(list(itertools.product((0.02, 0.3, 0.7, 1.0), (0.0, 0.5, 1.0), (0.1, 0.5, 0.95))))
    cases = np.zeros(len(grid), CASE)
    cases["base_color"], cases["reflectance"] = (0.9, 0.5, 0.1), 0.7
    for column, name in enumerate(("perceptual_roughness", "metallic", "cosine")):
        cases[name] = grid[:, column]
    buffer = device.buffer(cases.nbytes, "cases")
    buffer.upload(cases)
    table, tables = brdf_table.compute(device)
    constants = {"brdf_layering": ["conserving", "sum", "fresnel_product"].index(layering)}
    albedo_pass = Pass("world_cache_test/albedo", threads=len(cases), constants=constants)
    stage = Stage("albedo", buffers={"albedos": 2 * len(cases)}, passes=[albedo_pass])
    roots = [*([root] if root else []), SHADERS]
    with Frame(device, [stage], external={"cases": buffer, **tables}, glsl_root=roots) as frame:
        frame.submit()
        ours, summed = frame["albedos"].reshape(-1, 2, 3).swapaxes(0, 1)
    table.close()
    buffer.destroy()
    np.testing.assert_allclose(ours[: len(cases)], summed[: len(cases)], rtol=0.015, atol=0.003)


def test_cells_double_with_distance(device):
    """Sizes of a far camera's cells: two levels, the coarser as often as the fraction of the level says, cubed."""
    scene = sv.builtin("closed_box")
    camera = sv.Camera.look_at((0.9, 0.9, 0.9), (0, 0, 0))
    chosen = settings(world_cache_lod_distance=0.6, world_cache_jitter=0.0, world_cache_leak_prevention=False)
    with CacheFrame(device, scene, chosen) as frame:
        frame.run(8, camera)
        bounds = frame.cells()["bounds"]
    level = np.log2(1 + np.linalg.norm(bounds[:, :3] + bounds[:, 3:] / 2 - 0.9, axis=1) / 0.6)
    size = np.log2(bounds[:, 3] / 0.15)
    np.testing.assert_allclose(size, np.round(size), atol=1e-5)
    assert size.max() == 3
    slack = 0.5  # a cell's far corner may be farther than its middle by its own size
    assert (size >= np.floor(level - slack)).all()
    assert (size <= np.ceil(level + slack)).all()


def light_behind_a_wall(device, prevention, root=None):
    scene = sv.builtin("thin_wall")
    cameras = [sv.Camera.look_at((x, 1.0, 0.0), (2 * x, 1, 0)) for x in (-0.7, 0.7)]
    with CacheFrame(device, scene, settings(world_cache_leak_prevention=prevention), glsl_root=root) as frame:
        for turn in range(30):
            frame.run(1, cameras[turn % 2])
        cells = frame.cells()
    right = cells["bounds"][:, 0] >= 0
    return cells["irradiance"][right, 0].mean()


def check_thin_wall(device, root=None):
    assert light_behind_a_wall(device, True, root) < 1e-3


def test_thin_wall(device):
    """Where all the light is on the wall's other side, nothing is found in the cache unless leaks are allowed."""
    check_thin_wall(device)
    assert light_behind_a_wall(device, prevention=False) > 1e-3


MUTANTS = {
    "no 1 / pi": (check_fixed_point, "query.glsl", "vec3 reflectance = INVERSE_PI * ",
                  "vec3 reflectance = "),
    "indirect without pi": (check_fixed_point, "sample_indirect.comp", "PI * gathered", "gathered"),
    "direct: 1 / M dropped": (check_fixed_point, "sample_direct.comp",
                              "(float(uniforms.world_cache_candidates) * chosen_target)", "chosen_target"),
    "direct: no cosine": (check_fixed_point, "sample_direct.comp", "light.received_radiance * (cosine * inverse_pdf)",
                          "light.received_radiance * inverse_pdf"),
    "direct: measure swapped": (check_fixed_point, "sample_direct.comp", "float weight = target * light.inverse_pdf;",
                                "float weight = target / max(light.solid_angle_pdf, 1e-6);"),
    "indirect forgotten": (check_fixed_point, "sample_indirect.comp", "PI * gathered", "1e-9 * gathered"),
    "unknown: the path ends": (check_overfull, "query.glsl", "if (cached.found || uniforms.world_cache == 0u)",
                               "if (true)"),
    "unknown: the next ray without pi": (check_overfull, "query.glsl", "throughput *= PI;", ""),
    "walls that hide nothing": (check_thin_wall, "query.glsl", "dot(way, normal) * normal, 1.0)) { break; }",
                                "dot(way, normal) * normal, 1e-3)) { break; }"),
    "albedo: metals black": (check_albedo, "query.glsl", "specular_albedo(material.base_color, ab), ", "vec3(0.0), "),
    "albedo: nothing under the layer": (check_albedo, "query.glsl", "dielectric + through * material.base_color",
                                        "dielectric"),
}  # fmt: skip


@pytest.mark.parametrize("name", MUTANTS)
def test_seeded_bug_is_noticed(device, patched, name):
    check, *patch = MUTANTS[name]
    root = patched(*patch)
    less = {"seeds": 2, "bar": 0.15, "warm_up": 20} if check is check_fixed_point else {}
    with pytest.raises(AssertionError):
        check(device, root, **less)
