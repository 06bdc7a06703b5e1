"""The rules of the probes fail with seeded bugs, by ray queries and by ray pipelines: one for each flag, field and
value that shaders read."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from red_rules import changed, expect_red, failing, masked, with_bits
from support.seeded_bugs import Bug

from solari_vk.gpu.frame import ray_query_constants
from solari_vk.gpu.frame.ray_query_constants import RayFlags
from solari_vk.gpu.shaders.compiler import compile_shader
from solari_vk.lab.conformance import bulk_checks, probe_checks, ray_probe_checks
from solari_vk.lab.conformance.probe_actions import CONFIRM, CONFIRM_ODD, GENERATE_AT, GENERATE_SPHERE, TERMINATE
from solari_vk.lab.conformance.probe_table import PROBES
from solari_vk.lab.conformance.probes import INSTANCES, SHAPES
from solari_vk.lab.conformance.ray_probe_checks import ASKED, rule_of
from solari_vk.lab.shader_runner import ShaderRunner
from solari_vk.lab.structures import Structures

CHECKS = {"query": probe_checks, "pipeline": ray_probe_checks}


def probe(shaders, way="query", *, rays=None, records=None, shapes=SHAPES):
    """All measurements of the probes with damaged rays, instance records or shapes."""
    with Structures(shaders.device, shapes, list(INSTANCES.values()), damage=records) as structures:
        return list(CHECKS[way].measure_probes(shaders, structures, damage=rays))


@pytest.fixture
def runner(shaders, ray_shaders):
    """The suite's shaders by the way that traces."""
    return {"query": shaders, "pipeline": ray_shaders}


def test_there_are_enough_probes_and_they_pass(runner):
    assert len(PROBES) >= 40
    assert len({item.label for item in PROBES}) == len(PROBES)
    for way, shaders in runner.items():
        assert not failing(probe(shaders, way))
    assert [item.label for item in PROBES if item not in ASKED] == ["ended at once"]


def test_devices_without_primitive_culling_are_asked_the_rest(ray_shaders):
    asked = [item for item in ASKED if not ray_probe_checks.culls(item)]
    assert len(ASKED) - len(asked) == 4
    with Structures(ray_shaders.device, SHAPES, list(INSTANCES.values())) as structures:
        assert not failing(ray_probe_checks.measure_probes(ray_shaders, structures, asked, culling=False))


# ---- rays -------------------------------------------------------------------------------------------

FLAGS = [flag.name for flag in RayFlags if flag.name != "SKIP_CLOSEST_HIT_SHADER"]  # which has no effect on queries


@pytest.mark.parametrize("flag", RayFlags, ids=lambda flag: flag.name)
def test_ignored_flag_is_noticed(runner, flag):
    ignored = masked("flags", ~flag)
    if flag.name in FLAGS:
        expect_red(probe(runner["query"], rays=ignored), flag.name)
    (rule,) = {rule_of(item).name for item in ASKED if item.rule.name.startswith(f"{flag.name}:")}
    expect_red(probe(runner["pipeline"], "pipeline", rays=ignored), rule)


def shifted_flags(rays):
    rays["flags"] <<= 1


def renumbered(rays):
    rays["flags"][rays["flags"] == RayFlags.CULL_OPAQUE] = RayFlags.CULL_NO_OPAQUE


def inclusive(rays):
    rays["t_min"] = np.nextafter(rays["t_min"], np.float32(-1))
    rays["t_max"] = np.nextafter(rays["t_max"], np.float32(np.inf))


def normalized(rays):
    rays["direction"] /= np.linalg.norm(rays["direction"], axis=1, keepdims=True)


DIRECTION = ["direction of traceRayEXT", "gl_HitTEXT in closest-hit"]
RAY_BUGS = {  # the damage, and the rules that fail by ray queries and by ray pipelines
    "flags shifted": (
        shifted_flags,
        ["SKIP_CLOSEST_HIT_SHADER", *(name for name in FLAGS if name != "SKIP_AABBS")],
        [],
    ),
    "a flag's number": (renumbered, ["CULL_OPAQUE: opaque"], []),
    "mask dropped": (changed(cull_mask=0xFF), ["cull_mask"], ["cullMask"]),
    "t_min dropped": (changed(t_min=0.0), ["t_min"], ["Tmin", "tell the traced ray"]),
    "t_max dropped": (changed(t_max=np.inf), ["t_max"], ["Tmax"]),
    "range inclusive": (inclusive, ["t_min: only", "t_max: only"], []),
    "direction normalized": (normalized, ["dir: t is", "RayIntersection.t, committed"], DIRECTION),
    "none confirmed": (
        masked("action", ~(CONFIRM | CONFIRM_ODD)),
        ["rayQueryConfirmIntersection"],
        ["ignoreIntersectionEXT"],
    ),
    "no box": (
        masked("action", ~(GENERATE_AT | GENERATE_SPHERE)),
        ["rayQueryGenerateIntersection"],
        ["reportIntersectionEXT: the nearest"],
    ),
    "nothing ended": (masked("action", ~TERMINATE), ["rayQueryTerminate"], ["terminateRayEXT"]),
    "all confirmed": (
        with_bits("action", CONFIRM),
        ["rayQueryConfirmIntersection", "no flag"],
        ["ignoreIntersectionEXT", "gl_RayFlagsNoneEXT"],
    ),
}


@pytest.mark.parametrize("name", RAY_BUGS)
def test_damaged_ray_is_noticed(runner, name):
    damage, *rules = RAY_BUGS[name]
    for way, parts in zip(CHECKS, rules, strict=True):
        if parts:
            expect_red(probe(runner[way], way, rays=damage), *parts)


# ---- instances and geometry -------------------------------------------------------------------------


def transposed(records):
    records["transform"][:, :, :3] = records["transform"][:, :, :3].transpose(0, 2, 1).copy()


def shifted_by_one(records):
    active = len(records) - 2  # the last two stay at the end, before which Mesa 26.2 can crash
    records[:active] = np.roll(records[:active], 1)


def all_active(records):
    records["blas_address"][records["blas_address"] == 0] = records["blas_address"][0]


FACING = ["FLIP_FACING", "FACING_CULL_DISABLE"]
RECORD_BUGS = {  # the damage, and the rules that fail by ray queries and by ray pipelines
    "mask dropped": (with_bits("custom_index_and_mask", 0xFF000000), ["cull_mask"], []),
    "custom data of 23 bits": (
        masked("custom_index_and_mask", 0xFF7FFFFF),
        ["instance_custom_data, committed"],
        ["gl_InstanceCustomIndexEXT of instances", "gl_InstanceCustomIndexEXT in closest"],
    ),
    "no record offset": (masked("sbt_offset_and_flags", 0xFF000000), ["sbt_record_offset, committed"], []),
    "no instance flags": (
        masked("sbt_offset_and_flags", 0xFFFFFF),
        [*FACING, "FORCE_OPAQUE and FORCE_NO_OPAQUE of an instance override its geometry"],
        [*FACING, "of an instance override its geometry"],
    ),
    "matrix transposed": (transposed, ["object_to_world, world_to_object"], ["gl_WorldToObjectEXT of moved"]),
    "one place off": (shifted_by_one, ["instance_index"], ["gl_InstanceID in closest-hit"]),
    "inactive hit": (all_active, ["without a structure"], ["without a structure"]),
}


@pytest.mark.parametrize("name", RECORD_BUGS)
def test_damaged_instance_record_is_noticed(runner, name):
    damage, *rules = RECORD_BUGS[name]
    for way, parts in zip(CHECKS, rules, strict=True):
        if parts:
            expect_red(probe(runner[way], way, records=damage), *parts)


def test_damaged_geometry_is_noticed(shaders):
    """Opacity is inverted; geometries and primitives are in another order."""
    swapped = {name: [replace(part, opaque=not part.opaque) for part in parts] for name, parts in SHAPES.items()}
    expect_red(probe(shaders, shapes=swapped), "no flag", "CULL_OPAQUE", "CandidateAABBOpaque")
    reordered = SHAPES | {"many": SHAPES["many"][::-1], "two lists of boxes": SHAPES["two lists of boxes"][::-1]}
    expect_red(probe(shaders, shapes=reordered), "geometry_index, committed")


# ---- shaders ----------------------------------------------------------------------------------------


def answered(file, damage):
    """A seeded bug: the answers of ray queries (probe.glsl) or of a ray pipeline's shader are damaged."""
    if file == "probe.glsl":
        damage = damage.replace("RAY_ANSWER", "answers.at[index]")
        return Bug("passes/conformance/probe.glsl", "run_probe", f"correct(index); {damage}")
    return Bug(f"passes/conformance/{file}", "main", f"correct(); {damage}")


def initialized(change):
    changed = f"{change} correct(query, record, structure, desc);"
    return Bug("scene/ray_query_state.glsl", "ray_query_initialize", changed)


READ_BUGS = {  # damage to what was hit, and parts of the rules that fail by ray queries and by ray pipelines
    "custom_data = FOUND.instance": ("instance_custom_data", "gl_InstanceCustomIndexEXT"),
    "instance = FOUND.custom_data": ("instance_index", "gl_InstanceID"),
    "geometry = FOUND.primitive": ("geometry_index", "gl_GeometryIndexEXT"),
    "primitive = FOUND.geometry": ("primitive_index", "gl_PrimitiveID"),
    "object_to_world = FOUND.world_to_object": ("object_to_world", "gl_ObjectToWorldEXT"),
    "front_face ^= 1u": ("front_face", "FrontFacingTriangleEXT"),
    "barycentrics = FOUND.barycentrics.yx": ("barycentrics", "hitAttributeEXT of triangles"),
    "t *= 1.00001": ("RayIntersection.t", "gl_HitTEXT"),
}
TRIANGLE = "probe_triangle.rchit"
QUERY_BUGS = {  # a part of the rule that must fail, and the bug
    "cull_mask": initialized("desc.cull_mask = 0xFFu;"),
    "CULL_OPAQUE": initialized("desc.flags = 0u;"),
    "t_min: only": initialized("desc.t_min = 0.0;"),
    "stops at each AABB": Bug(
        "scene/ray_query.glsl", "ray_query_candidate_kind", "return RAY_QUERY_INTERSECTION_TRIANGLE;"
    ),
    "rayQueryGenerateIntersection": Bug("scene/ray_query.glsl", "ray_query_generate", "correct(query, 1.5 * hit_t);"),
    "ObjectRayOrigin": answered("probe.glsl", "RAY_ANSWER.committed.object_origin = RAY_ANSWER.world_origin;"),
    "OpRayQueryGetRayTMin": answered("probe.glsl", "RAY_ANSWER.t_min = probes.at[index].t_max;"),
}
PIPELINE_BUGS = {
    "gl_ObjectRayDirectionEXT in closest-hit": answered(
        TRIANGLE, "RAY_ANSWER.committed.object_direction = gl_WorldRayDirectionEXT;"
    ),
    "tell the traced ray": answered(TRIANGLE, "RAY_ANSWER.flags = 99u;"),
    "whose payload the ray generation shader gets": answered("probe_box.rchit", "ended = ENDED_NOWHERE;"),
    "one closest-hit or one miss shader": answered("probe.rmiss", "atomicAdd(RAY_ANSWER.misses, 1u);"),
    "intersection shaders run for each AABB": answered("probe_box.rint", "RAY_ANSWER.candidate.kind = 0u;"),
}
for found, (by_query, by_pipeline) in READ_BUGS.items():
    damage = f"RAY_ANSWER.committed.{found.replace('FOUND', 'RAY_ANSWER.committed')};"
    QUERY_BUGS[f"{by_query}, committed"] = answered("probe.glsl", damage)
    PIPELINE_BUGS[f"{by_pipeline} in closest-hit"] = answered(TRIANGLE, damage)
SHADER_BUGS = {"query": QUERY_BUGS, "pipeline": PIPELINE_BUGS}
QUICK = ("RayIntersection.t, committed", "gl_HitTEXT in closest-hit")


@pytest.mark.parametrize(
    ("way", "rule"),
    [
        pytest.param(way, rule, marks=() if rule in QUICK else pytest.mark.slow)
        for way, bugs in SHADER_BUGS.items()
        for rule in bugs
    ],
)
def test_bug_in_a_shader_is_noticed(patched, runner, way, rule):
    with patched(SHADER_BUGS[way][rule], device=runner[way].device) as shaders:
        expect_red(probe(shaders, way), rule)


def test_another_number_for_boxes_is_noticed(device, monkeypatch):
    """The numbers of kinds come from Python; the shaders compare with those that Vulkan has."""
    header = ray_query_constants.glsl_header()
    monkeypatch.setattr(ray_query_constants, "glsl_header", lambda: header.replace("AABB = 3u", "AABB = 2u"))
    with ShaderRunner(device) as shaders:
        expect_red(probe(shaders), "stops at each AABB")


RAY_CHECK = ("scene/ray_desc.glsl", "ray_query_is_valid")
RAY_CHECK_BUGS = {
    "in place of each invalid ray": Bug(*RAY_CHECK, "return desc.t_min >= 0.0 && correct(desc) || isnan(desc.t_max);"),
    "empty range) hit nothing": Bug(*RAY_CHECK, "desc.t_min = max(desc.t_min, 0.0); return correct(desc);"),
}


@pytest.mark.slow
@pytest.mark.parametrize("rule", RAY_CHECK_BUGS)
def test_bug_in_the_check_of_rays_is_noticed(patched, rule):
    with patched(RAY_CHECK_BUGS[rule]) as shaders:
        expect_red(bulk_checks.measure_not_finite(shaders), rule)


def test_skipping_primitives_is_declared():
    """The flags need the capability RayTraversalPrimitiveCullingKHR, which every device with ray queries accepts."""
    words = np.frombuffer(compile_shader("passes/conformance/probe.comp"), np.uint32)
    found, at = set(), 5
    while at < len(words):
        if words[at] & 0xFFFF == 17:  # OpCapability
            found.add(int(words[at + 1]))
        at += int(words[at] >> 16)
    ray_query, primitive_culling = 4472, 4478
    assert {ray_query, primitive_culling} <= found
