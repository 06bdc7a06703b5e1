"""Seeded bugs in the ray-query library: the test that should notice each must fail."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
import test_builds as builds
import test_ray_queries as queries

from solari_vk import rt
from solari_vk.errors import SolariError
from solari_vk.gpu.shaders import compiler
from solari_vk.gpu.shaders.compiler import glsl_root

QUERY, DEBUG = "scene/ray_query.glsl", "scene/ray_query_debug.glsl"
VULKAN = queries.test_wrong_rays_meet_nothing_and_never_reach_vulkan
# The file, what it holds, what is put in its place, and the test.
MUTANTS: dict[str, tuple[str, str, str, Any]] = {
    "a flag's value": (QUERY, "CULL_OPAQUE = 0x40u", "CULL_OPAQUE = 0x80u", "values"),
    "a kind's value": (QUERY, "GENERATED = 2u", "GENERATED = 4u", "values"),
    "no cull mask": (QUERY, "desc.cull_mask & 0xFFu", "0xFFu", builds.test_instances),
    "flags dropped": (QUERY, "structure, desc.flags,", "structure, 0u,", "flags"),
    "t_min dropped": (QUERY, "desc.t_min, desc.dir", "0.0, desc.dir", queries.test_ranges_and_terminate),
    "t_max dropped": (QUERY, "desc.dir, desc.t_max", "desc.dir, 1e30", queries.test_ranges_and_terminate),
    "custom data for the index": (QUERY, "InstanceIdEXT", "InstanceCustomIndexEXT", queries.test_what_the_getters_say),
    "index for the custom data": (QUERY, "InstanceCustomIndexEXT", "InstanceIdEXT", queries.test_what_the_getters_say),
    "primitive for geometry": (QUERY, "GeometryIndexEXT", "PrimitiveIndexEXT", builds.test_boxes_with_a_stride),
    "geometry for primitive": (QUERY, "PrimitiveIndexEXT", "GeometryIndexEXT", builds.test_boxes_with_a_stride),
    "matrices swapped": (
        QUERY,
        "found.object_to_world = rayQueryGetIntersectionObjectToWorldEXT",
        "found.object_to_world = rayQueryGetIntersectionWorldToObjectEXT",
        queries.test_matrices_are_not_swapped_or_transposed,
    ),
    "front for back": (QUERY, "= rayQueryGetIntersectionFrontFaceEXT", "= !rayQueryGetIntersectionFrontFaceEXT",
                       queries.test_what_the_getters_say),
    "barycentrics swapped": (QUERY, "BarycentricsEXT(query, COMMITTED)", "BarycentricsEXT(query, COMMITTED).yx",
                             queries.test_what_the_getters_say),
    "boxes as triangles": (QUERY, ": RAY_QUERY_INTERSECTION_AABB;", ": RAY_QUERY_INTERSECTION_TRIANGLE;",
                           queries.test_what_the_getters_say),
    "t of boxes": (QUERY, "found.t = rayQuery", "found.t = 1.0 + rayQuery", queries.test_what_the_getters_say),
    "a hit behind a hit": (QUERY, "if (none || hit_t <=", "if (none || hit_t >=",
                           queries.test_no_hit_is_generated_behind_a_committed_one),
    "no terminate": (QUERY, "#define rayQueryTerminate(query) rayQueryTerminateEXT(query)",
                     "#define rayQueryTerminate(query) rayQueryConfirmIntersectionEXT(query)",
                     queries.test_ranges_and_terminate),
    "faults not counted": (DEBUG, "!kept && atomicAdd(ray_query_faults.at[fault].count, 1u) == 0u", "!kept", 1),
    "a fault's effect": (DEBUG, "return kept;", "return true;", 2),
    "the wrong invocation": (DEBUG, ".invocation = RAY_QUERY_INVOCATION", ".invocation = uvec3(0u)", 6),
    "rays unchecked": (DEBUG, "ray_query_is_valid(desc), F", "true, F",
                       queries.test_wrong_rays_meet_nothing_when_debugging),
    "t_min unchecked": (QUERY, "desc.t_min >= 0.0 && ", "", queries.test_wrong_rays_meet_nothing_when_debugging),
    "range unchecked": (QUERY, "&& desc.t_min <= desc.t_max;", ";", VULKAN),
    "NaN in ranges": (QUERY, "finite && numbers && any", "finite && any", VULKAN),
    "origins unchecked": (QUERY, "all(lessThan(origin, uvec3(infinity))) && ", "", VULKAN),
    "directions unchecked": (QUERY, "&& all(lessThan(dir, uvec3(infinity)));", ";", VULKAN),
    "no direction": (QUERY, " && any(notEqual(desc.dir, vec3(0.0)))", "", VULKAN),
    "an endless ray refused": (QUERY, "t_max <= infinity", "t_max < infinity", VULKAN),
    "wrong rays to Vulkan": (QUERY, "if (!ray_query_is_valid(desc)) {", "if (false) {", VULKAN),
    "culling undeclared": (QUERY, "layout(primitive_culling);", "",
                           queries.test_skipping_primitives_is_declared),
    "flags unchecked": (DEBUG, "ray_query_flags_agree(desc.flags), F", "true, F", "contradiction"),
    "not kept: before proceed": (DEBUG, "record.phase >= RAY_QUERY_AT_CANDIDATE, F", "true, F", 0),
    "not kept: committed": (DEBUG, "RAY_QUERY_DONE, FAULT_COMMITTED_WHILE", "record.phase, FAULT_COMMITTED_WHILE", 1),
    "not kept: candidate": (DEBUG, "RAY_QUERY_AT_CANDIDATE, FAULT_CANDIDATE_WHILE",
                            "record.phase, FAULT_CANDIDATE_WHILE", 2),
    "not kept: initialize": (DEBUG, "RAY_QUERY_UNKNOWN, FAULT_PROCEED", "99u, FAULT_PROCEED", 6),
    "not kept: AABB": (DEBUG, "ray_query_rule(box, F", "ray_query_rule(true, F", 7),
    "not kept: range": (DEBUG, "ray_query_rule(inside, F", "ray_query_rule(true, F", 8),
    "not kept: low end": (DEBUG, "hit_t >= record.t_min && ", "", 8),
    "not kept: high end": (DEBUG, " && hit_t <= record.t_max", "", 8),
    "not kept: generate": (DEBUG, "AT_CANDIDATE, FAULT_GENERATE", "AT_CANDIDATE || true, FAULT_GENERATE", 9),
    "not kept: triangle": (DEBUG, "ray_query_rule(triangle, FAULT_CONFIRM", "ray_query_rule(true, FAULT_CONFIRM", 10),
    "not kept: confirm": (DEBUG, "AT_CANDIDATE, FAULT_CONFIRM", "AT_CANDIDATE || true, FAULT_CONFIRM", 11),
    "not kept: terminate": (DEBUG, "RAY_QUERY_UNKNOWN, FAULT_TERMINATE", "99u, FAULT_TERMINATE", 12),
    "two rules exchanged": (DEBUG, "FAULT_GENERATE_OF_NO_AABB = 7u", "FAULT_GENERATE_OF_NO_AABB = 8u", 7),
}


def run(check: Any, world: Any, mixed: rt.Tlas, folder: Path) -> None:
    """One of the tests, with its own idea of arguments; a number stands for the cases of that rule."""
    device = world.device
    if check == "values":
        queries.test_flags_and_kinds_have_the_documents_values()
    elif check == "flags":
        queries.test_flags(device, mixed, 0x20, [0, 0, 2, 2, 0], [0, 0, 1, 1, 0], "")
    elif check == "contradiction":
        queries.test_contradicting_flags(device, mixed, 0x3)
    elif isinstance(check, int):
        for code in queries.CASES[check]:
            queries.test_a_broken_rule_is_counted_and_harmless(device, mixed, folder, check, code)
    elif "world" in check.__annotations__:
        check(world)
    elif "tmp_path" in check.__annotations__:
        check(device, mixed, folder)
    elif "device" not in check.__annotations__:
        check()
    else:
        check(device, mixed)


mixed = queries.mixed  # the fixture
QUICK = ("no cull mask", "matrices swapped", "t_max dropped", "a fault's effect", "not kept: high end",
         "wrong rays to Vulkan")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in ("nothing", *MUTANTS)]
)
def test_seeded_bugs_are_noticed(
    world: Any, mixed: rt.Tlas, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    root = tmp_path / "glsl"
    shutil.copytree(glsl_root(), root, ignore=shutil.ignore_patterns("*.spv", "*.json"))
    monkeypatch.setattr(compiler, "glsl_root", lambda: root)
    monkeypatch.setattr(queries, "glsl_root", lambda: root)
    if name == "nothing":
        for check in dict.fromkeys(mutant[-1] for mutant in MUTANTS.values()):
            run(check, world, mixed, tmp_path)
        return
    file, old, new, check = MUTANTS[name]
    text = (root / file).read_text()
    assert text.count(old) == 1, f"{file} holds {old!r} {text.count(old)} times"
    (root / file).write_text(text.replace(old, new))
    with pytest.raises((AssertionError, SolariError, pytest.fail.Exception)):
        run(check, world, mixed, tmp_path)
