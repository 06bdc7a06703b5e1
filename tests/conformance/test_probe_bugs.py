"""The rules of the probes fail with seeded bugs: one for each flag, field and getter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from red_rules import expect_red, failing, masked
from support.seeded_bugs import Bug

from solari_vk.conformance import bulk_checks, probe_actions, probe_checks
from solari_vk.conformance.probe_table import PROBES
from solari_vk.conformance.probes import INSTANCES, SHAPES
from solari_vk.conformance.shader_runner import ShaderRunner
from solari_vk.conformance.worlds import World
from solari_vk.gpu.frame import ray_query_constants
from solari_vk.gpu.frame.ray_query_constants import RayFlags
from solari_vk.gpu.shaders.compiler import compile_shader


def probe(shaders, *, rays=None, records=None, shapes=SHAPES):
    """All measurements of the probes with damaged rays, instance records or shapes."""
    with World(shaders.device, shapes, list(INSTANCES.values()), damage=records) as world:
        return list(probe_checks.measure_probes(shaders, world, damage=rays))


def test_there_are_enough_probes_and_they_pass(shaders):
    assert len(PROBES) >= 40
    assert len({item.label for item in PROBES}) == len(PROBES)
    assert not failing(probe(shaders))


def without_flag(flag):
    def damage(rays):
        rays["flags"] &= ~np.uint32(flag)

    return damage


FLAGS = [flag.name for flag in RayFlags if flag.name != "SKIP_CLOSEST_HIT_SHADER"]  # which has no effect


@pytest.mark.parametrize("name", FLAGS)
def test_ignored_flag_is_noticed(shaders, name):
    expect_red(probe(shaders, rays=without_flag(RayFlags[name])), name)


def test_wrong_flag_values_are_noticed(shaders):
    def shift(rays):
        rays["flags"] <<= 1

    expect_red(probe(shaders, rays=shift), "SKIP_CLOSEST_HIT_SHADER", *(name for name in FLAGS if name != "SKIP_AABBS"))


def set_field(**values):
    def damage(rays):
        for field, value in values.items():
            rays[field] = value

    return damage


def normalized(rays):
    rays["direction"] /= np.linalg.norm(rays["direction"], axis=1, keepdims=True)


def without_action(bit):
    def damage(rays):
        rays["action"] &= ~np.uint32(bit)

    return damage


def inclusive(rays):
    rays["t_min"] = np.nextafter(rays["t_min"], np.float32(-1))
    rays["t_max"] = np.nextafter(rays["t_max"], np.float32(np.inf))


RAY_BUGS = {
    "mask dropped": (set_field(cull_mask=0xFF), ["cull_mask"]),
    "t_min dropped": (set_field(t_min=0.0), ["t_min"]),
    "t_max dropped": (set_field(t_max=np.inf), ["t_max"]),
    "range inclusive": (inclusive, ["t_min: only", "t_max: only"]),
    "direction normalized": (normalized, ["dir: t is", "RayIntersection.t, committed"]),
    "nothing confirmed": (without_action(probe_actions.CONFIRM), ["rayQueryConfirmIntersection"]),
    "nothing generated": (
        without_action(probe_actions.GENERATE_AT | probe_actions.GENERATE_SPHERE),
        ["rayQueryGenerateIntersection"],
    ),
    "nothing terminated": (without_action(probe_actions.TERMINATE), ["rayQueryTerminate"]),
    "all confirmed": (lambda rays: np.bitwise_or(rays["action"], probe_actions.CONFIRM, out=rays["action"]),
                      ["rayQueryConfirmIntersection", "no flag"]),
}  # fmt: skip


@pytest.mark.parametrize("name", RAY_BUGS)
def test_damaged_ray_is_noticed(shaders, name):
    damage, rules = RAY_BUGS[name]
    expect_red(probe(shaders, rays=damage), *rules)


def transposed(records):
    records["transform"][:, :, :3] = records["transform"][:, :, :3].transpose(0, 2, 1).copy()


def shifted_by_one(records):
    active = len(records) - 2  # the last two stay at the end, before which Mesa 26.2 can crash
    records[:active] = np.roll(records[:active], 1)


def all_active(records):
    records["blas_address"][records["blas_address"] == 0] = records["blas_address"][0]


RECORD_BUGS = {
    "mask dropped": (lambda r: np.bitwise_or(r["custom_index_and_mask"], 0xFF000000, out=r["custom_index_and_mask"]),
                     ["cull_mask"]),
    "custom data of 23 bits": (masked("custom_index_and_mask", 0xFF7FFFFF), ["instance_custom_data, committed"]),
    "no record offset": (masked("sbt_offset_and_flags", 0xFF000000), ["sbt_record_offset, committed"]),
    "no instance flags": (
        masked("sbt_offset_and_flags", 0xFFFFFF),
        ["FLIP_FACING", "FACING_CULL_DISABLE", "FORCE_OPAQUE and FORCE_NO_OPAQUE of an instance override its geometry"],
    ),
    "matrix transposed": (transposed, ["object_to_world, world_to_object"]),
    "one place off": (shifted_by_one, ["instance_index"]),
    "inactive hit": (all_active, ["without a structure"]),
}  # fmt: skip


@pytest.mark.parametrize("name", RECORD_BUGS)
def test_damaged_instance_record_is_noticed(shaders, name):
    damage, rules = RECORD_BUGS[name]
    expect_red(probe(shaders, records=damage), *rules)


def test_damaged_geometry_is_noticed(shaders):
    """Opacity is inverted; geometries and primitives are in another order."""
    swapped = {name: [replace(part, opaque=not part.opaque) for part in parts] for name, parts in SHAPES.items()}
    expect_red(probe(shaders, shapes=swapped), "no flag", "CULL_OPAQUE", "CandidateAABBOpaque")
    reordered = SHAPES | {"many": SHAPES["many"][::-1], "two lists of boxes": SHAPES["two lists of boxes"][::-1]}
    expect_red(probe(shaders, shapes=reordered), "geometry_index", "geometry_index, committed")


QUERY = "scene/ray_query.glsl"


def answered(damage):
    """A seeded bug: probes' answers are damaged."""
    found = "answers.at[index].committed"
    return Bug("passes/conformance/probe.glsl", "run_probe", f"correct(index); {damage.replace('FOUND', found)}")


SHADER_BUGS = {  # parts of the name of the rule that must fail, and the bug
    "cull_mask": Bug(QUERY, "ray_query_initialize", "desc.cull_mask = 0xFFu; correct(query, structure, desc);"),
    "CULL_OPAQUE": Bug(QUERY, "ray_query_initialize", "desc.flags = 0u; correct(query, structure, desc);"),
    "t_min: only": Bug(QUERY, "ray_query_initialize", "desc.t_min = 0.0; correct(query, structure, desc);"),
    "stops at each AABB": Bug(QUERY, "ray_query_candidate_kind", "return RAY_QUERY_INTERSECTION_TRIANGLE;"),
    "rayQueryGenerateIntersection": Bug(QUERY, "ray_query_generate", "correct(query, 1.5 * hit_t);"),
    "instance_custom_data, committed": answered("FOUND.custom_data = FOUND.instance;"),
    "instance_index, committed": answered("FOUND.instance = FOUND.custom_data;"),
    "geometry_index, committed": answered("FOUND.geometry = FOUND.primitive;"),
    "primitive_index, committed": answered("FOUND.primitive = FOUND.geometry;"),
    "object_to_world, committed": answered("FOUND.object_to_world = FOUND.world_to_object;"),
    "front_face, committed": answered("FOUND.front_face ^= 1u;"),
    "barycentrics, committed": answered("FOUND.barycentrics = FOUND.barycentrics.yx;"),
    "t, committed": answered("FOUND.t *= 1.00001;"),
    "ObjectRayOrigin": answered("FOUND.object_origin = answers.at[index].world_origin;"),
    "OpRayQueryGetRayTMin": answered("answers.at[index].t_min = probes.at[index].t_max;"),
}
QUICK = ("t, committed",)


@pytest.mark.parametrize("rule", [rule if rule in QUICK else pytest.param(rule, marks=pytest.mark.slow)
                                  for rule in SHADER_BUGS])  # fmt: skip
def test_bug_in_a_shader_is_noticed(patched, rule):
    with patched(SHADER_BUGS[rule]) as shaders:
        expect_red(probe(shaders), rule)


def test_another_number_for_boxes_is_noticed(device, monkeypatch):
    """The numbers of kinds come from Python; the shaders compare with those that Vulkan has."""
    header = ray_query_constants.glsl_header()
    monkeypatch.setattr(ray_query_constants, "glsl_header", lambda: header.replace("AABB = 3u", "AABB = 2u"))
    with ShaderRunner(device) as shaders:
        expect_red(probe(shaders), "stops at each AABB")


def test_another_number_for_a_flag_is_noticed(shaders):
    """The numbers of flags come from Python too: here CULL_OPAQUE gets the number of CULL_NO_OPAQUE."""

    def renumber(rays):
        rays["flags"][rays["flags"] == RayFlags.CULL_OPAQUE] = RayFlags.CULL_NO_OPAQUE

    expect_red(probe(shaders, rays=renumber), "CULL_OPAQUE: opaque")



RAY_CHECK = (QUERY, "ray_query_is_valid")
RAY_CHECK_BUGS = {
    "in place of each invalid ray": Bug(*RAY_CHECK, "return desc.t_min >= 0.0 && correct(desc) || isnan(desc.t_max);"),
    "empty range) hit nothing": Bug(*RAY_CHECK, "desc.t_min = max(desc.t_min, 0.0); return correct(desc);"),
}


@pytest.mark.slow
@pytest.mark.parametrize("rule", RAY_CHECK_BUGS)
def test_bug_in_the_check_of_rays_is_noticed(patched, rule):
    with patched(RAY_CHECK_BUGS[rule]) as shaders:
        expect_red(bulk_checks.measure_not_finite(shaders), rule)


def declared_capabilities():
    """The capabilities of the probes' SPIR-V."""
    words = np.frombuffer(compile_shader("passes/conformance/probe.comp"), np.uint32)
    found, at = set(), 5
    while at < len(words):
        if words[at] & 0xFFFF == 17:  # OpCapability
            found.add(int(words[at + 1]))
        at += int(words[at] >> 16)
    return found


def test_skipping_primitives_is_declared():
    """The flags need the capability RayTraversalPrimitiveCullingKHR, which every device with ray queries accepts."""
    ray_query, primitive_culling = 4472, 4478
    assert {ray_query, primitive_culling} <= declared_capabilities()
