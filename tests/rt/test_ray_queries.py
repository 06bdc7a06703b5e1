"""scene/ray_query.glsl: the document's getters, flags and kinds, and its undefined behaviours caught when debugging."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from probes import AABB, CONFIRM, GENERATE, GENERATED, GLSL, NONE, TERMINATE, TRIANGLE, quad, shifted, trace

from solari_vk import rt
from solari_vk.errors import SolariError
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Frame, Pass, Stage
from solari_vk.gpu.shaders.compiler import compile_shader, glsl_root
from solari_vk.scene.matrices import by_columns

CENTER = np.array([0.6, 0.2, 5.0])
# The document's values, written out once more.
FLAGS = {
    "FORCE_OPAQUE": 0x1,
    "FORCE_NO_OPAQUE": 0x2,
    "TERMINATE_ON_FIRST_HIT": 0x4,
    "SKIP_CLOSEST_HIT_SHADER": 0x8,
    "CULL_BACK_FACING": 0x10,
    "CULL_FRONT_FACING": 0x20,
    "CULL_OPAQUE": 0x40,
    "CULL_NO_OPAQUE": 0x80,
    "SKIP_TRIANGLES": 0x100,
    "SKIP_AABBS": 0x200,
    "RAY_QUERY_INTERSECTION_NONE": 0,
    "RAY_QUERY_INTERSECTION_TRIANGLE": 1,
    "RAY_QUERY_INTERSECTION_GENERATED": 2,
    "RAY_QUERY_INTERSECTION_AABB": 3,
}


def test_flags_and_kinds_have_the_documents_values() -> None:
    text = (glsl_root() / "scene/ray_query.glsl").read_text()
    found = {name: int(value, 0) for name, value in re.findall(r"^const uint (\w+) = (\w+)u;", text, re.MULTILINE)}
    assert found.pop("RAY_FLAG_NONE") == 0
    assert found == FLAGS


@pytest.fixture
def mixed(world: Any) -> rt.Tlas:
    """At x = 0 opaque triangles, 2 non-opaque ones, 4 opaque boxes, 6 non-opaque boxes; nothing at 8."""
    blases = []
    for geometry in (
        rt.Triangles(quad()),
        rt.Triangles(quad(), opaque=False),
        rt.Aabbs([[0, 0, 0, 1, 1, 1]]),
        rt.Aabbs([[0, 0, 0, 1, 1, 1]], opaque=False),
    ):
        blases.append(world.blas([geometry]))
        world.build([rt.BlasBuildEntry(blases[-1], [geometry])])
    tlas: rt.Tlas = world.tlas(4)
    items = [rt.TlasInstance(blas, shifted(2 * i), 100 + i) for i, blas in enumerate(blases)]
    world.build((), [rt.TlasPackage(tlas, items)])
    return tlas


FIVE = CENTER + np.array([[2 * i, 0, 0] for i in range(5)])
T, G, N = TRIANGLE, GENERATED, NONE


@pytest.mark.parametrize("header", ["", rt.RAY_QUERY_DEBUG], ids=["release", "debug"])
@pytest.mark.parametrize(
    ("flags", "kinds", "candidates"),
    [
        (0, [T, T, G, G, N], [0, 1, 1, 1, 0]),
        (FLAGS["FORCE_OPAQUE"], [T, T, G, G, N], [0, 0, 1, 1, 0]),
        (FLAGS["FORCE_NO_OPAQUE"], [T, T, G, G, N], [1, 1, 1, 1, 0]),
        (FLAGS["TERMINATE_ON_FIRST_HIT"], [T, T, G, G, N], [0, 1, 1, 1, 0]),
        (FLAGS["SKIP_CLOSEST_HIT_SHADER"], [T, T, G, G, N], [0, 1, 1, 1, 0]),
        (FLAGS["CULL_BACK_FACING"], [T, T, G, G, N], [0, 1, 1, 1, 0]),
        (FLAGS["CULL_FRONT_FACING"], [N, N, G, G, N], [0, 0, 1, 1, 0]),
        (FLAGS["CULL_OPAQUE"], [N, T, N, G, N], [0, 1, 0, 1, 0]),
        (FLAGS["CULL_NO_OPAQUE"], [T, N, G, N, N], [0, 0, 1, 0, 0]),
        (FLAGS["SKIP_TRIANGLES"], [N, N, G, G, N], [0, 0, 1, 1, 0]),
        (FLAGS["SKIP_AABBS"], [T, T, N, N, N], [0, 1, 0, 0, 0]),
    ],
)
def test_flags(device: Device, mixed: rt.Tlas, flags: int, kinds: Any, candidates: Any, header: str) -> None:
    answers = trace(device, mixed, FIVE, flags=flags, action=CONFIRM | GENERATE, hit_t=4.5, header=header)
    assert answers["hit"]["kind"].tolist() == kinds
    assert answers["candidates"].tolist() == candidates


def test_what_the_getters_say(device: Device, mixed: rt.Tlas) -> None:
    answers = trace(device, mixed, FIVE, action=CONFIRM | GENERATE, hit_t=4.5)
    hit, candidate = answers["hit"], answers["candidate"]
    assert hit["instance_custom_data"].tolist() == [100, 101, 102, 103, 0]
    assert hit["instance_index"].tolist() == [0, 1, 2, 3, 0]
    assert candidate["kind"].tolist() == [NONE, TRIANGLE, AABB, AABB, NONE]
    assert candidate["instance_custom_data"].tolist() == [0, 101, 102, 103, 0]
    assert candidate["t"].tolist() == [0, 5, 0, 0, 0]
    assert hit["t"].tolist() == [5, 5, 4.5, 4.5, 0]
    assert hit["barycentrics"][:2] == pytest.approx(np.array([[0.4, 0.2]] * 2), abs=1e-6)
    assert candidate["barycentrics"][1] == pytest.approx([0.4, 0.2], abs=1e-6)
    assert hit["front_face"].tolist() == [1, 1, 0, 0, 0]
    assert (hit["sbt_record_offset"] == 0).all()
    for intersection in (hit[:4], candidate[1:4]):
        first = int(intersection["instance_index"][0])
        moves = np.array([shifted(2 * (first + i)) for i in range(len(intersection))])
        assert np.allclose(by_columns(intersection["object_to_world"]), moves)
        moves[:, :, 3] *= -1
        assert np.allclose(by_columns(intersection["world_to_object"]), moves)


def test_matrices_are_not_swapped_or_transposed(world: Any) -> None:
    matrix = np.array([[0.5, 0.2, 0, 3], [-0.1, 2, 0.3, -1], [0, 0.4, -1.5, 2]])
    blas, tlas = world.blas(), world.tlas(1)
    world.build([world.entry(blas)], [rt.TlasPackage(tlas, [rt.TlasInstance(blas, matrix)])])
    target = matrix @ [0.5, 0.25, 0, 1]
    direction = matrix[:, :3] @ [0.1, 0.2, -1.0]
    hit = trace(world.device, tlas, target - 4 * direction, direction)["hit"][0]
    assert hit["t"] == pytest.approx(4, rel=1e-5)
    full = np.vstack([matrix, [0, 0, 0, 1]])
    assert np.allclose(by_columns(hit["object_to_world"]), matrix, atol=1e-6)
    assert np.allclose(by_columns(hit["world_to_object"]), np.linalg.inv(full)[:3], atol=1e-5)
    assert hit["front_face"]  # facing is the object's, however it is mirrored


def test_ranges_and_terminate(device: Device, mixed: rt.Tlas) -> None:
    kinds = [
        trace(device, mixed, CENTER, t_min=low, t_max=high)["hit"]["kind"][0]
        for low, high in ((0, 4.9), (0, 5.1), (4.9, 9), (5.1, 9))
    ]
    assert kinds == [NONE, TRIANGLE, TRIANGLE, NONE]
    stopped = trace(device, mixed, FIVE, action=TERMINATE)
    assert stopped["candidates"].tolist() == [0, 1, 1, 1, 0]
    assert stopped["hit"]["kind"].tolist() == [TRIANGLE, NONE, NONE, NONE, NONE]


def test_no_hit_is_generated_behind_a_committed_one(world: Any) -> None:
    geometries = [rt.Aabbs([[0, 0, 0, 1, 1, 1]] * 2, opaque=False)]
    boxes, wall, tlas = world.blas(geometries), world.blas(), world.tlas(2)
    world.build(
        [rt.BlasBuildEntry(boxes, geometries), world.entry(wall)],
        [rt.TlasPackage(tlas, [rt.TlasInstance(wall, shifted(0, 0, 0.5)), rt.TlasInstance(boxes)])],
    )
    for header in ("", rt.RAY_QUERY_DEBUG):
        answers = trace(
            world.device, tlas, [CENTER] * 3, action=GENERATE, hit_t=[4.2, 4.9, 4.4], hit_step=[0, 0, -0.2],
            header=header,
        )  # fmt: skip
        assert answers["hit"]["kind"].tolist() == [GENERATED, TRIANGLE, GENERATED]
        assert answers["hit"]["t"] == pytest.approx([4.2, 4.5, 4.2])
        answers = trace(
            world.device, tlas, CENTER, action=GENERATE, hit_t=4.2, hit_step=0.2, flags=FLAGS["SKIP_TRIANGLES"],
            header=header,
        )  # fmt: skip
        assert answers["candidates"].tolist() == [2]
        assert answers["hit"]["t"] == pytest.approx([4.2])


def wrong_rays() -> dict[str, Any]:
    """Rays through the opaque triangles: one that is right, and eleven with something wrong in each."""
    nan, inf = np.nan, np.inf
    origins, directions = np.array([CENTER] * 12), np.array([[0, 0, -1.0]] * 12)
    origins[1, 0], origins[3, 2] = nan, inf
    directions[2, 0], directions[4, 2], directions[5] = nan, -inf, 0
    limits = [(0, inf)] + [(0, 9)] * 5 + [(-1, 9), (nan, 9), (9, 2), (0, nan), (inf, inf), (-inf, inf)]
    t_min, t_max = zip(*limits, strict=True)
    return {"origins": origins, "directions": directions, "t_min": t_min, "t_max": t_max}


def test_wrong_rays_meet_nothing_when_debugging(device: Device, mixed: rt.Tlas) -> None:
    with pytest.raises(SolariError, match=r"a ray with NaN.*\(11 times, first in invocation \(\d+, 0, 0\)\)"):
        trace(device, mixed, **wrong_rays(), header=rt.RAY_QUERY_DEBUG)
    answers = trace(device, mixed, **wrong_rays(), header=rt.RAY_QUERY_DEBUG, check=False)
    assert answers["hit"]["kind"].tolist() == [TRIANGLE] + [NONE] * 11


def given_to_vulkan(device: Device, mixed: rt.Tlas, folder: Path) -> np.ndarray:
    """What the release build makes of the wrong rays: t_min, t_max, origin and direction as Vulkan has them."""
    (folder / "passes").mkdir(exist_ok=True)
    (folder / "passes/given.comp").write_text(GIVEN)
    stage = Stage("given", buffers={"rays": 12, "given": 12}, passes=[Pass("given", 12)])
    with Frame(device, [stage], external={"tlas": mixed}, glsl_root=folder) as frame:
        rays = np.zeros(12, frame.binding("rays").element)
        names = {"origin": "origins", "dir": "directions", "t_min": "t_min", "t_max": "t_max"}
        for field, name in names.items():
            rays[field] = wrong_rays()[name]
        rays["cull_mask"] = 0xFF
        frame.resource("rays").upload(rays)
        frame.submit()
        return np.asarray(frame["given"])


GIVEN = """
#version 460
#extension GL_EXT_scalar_block_layout : require
#include "scene/ray_query.glsl"
layout(local_size_x = 64) in;
layout(set = 0, binding = 0) uniform accelerationStructureEXT tlas;
layout(set = 1, binding = 0, scalar) readonly buffer RaysBlock { RayDesc at[]; } rays;
layout(set = 1, binding = 1, scalar) buffer GivenBlock { float at[][7]; } given;
void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i >= rays.at.length()) { return; }
    RAY_QUERY(query);
    rayQueryInitialize(query, tlas, rays.at[i]);
    vec3 origin = rayQueryGetWorldRayOriginEXT(query), dir = rayQueryGetWorldRayDirectionEXT(query);
    given.at[i] = float[7](rayQueryGetRayTMinEXT(query), origin.x, origin.y, origin.z, dir.x, dir.y, dir.z);
}
"""


def test_wrong_rays_meet_nothing_and_never_reach_vulkan(device: Device, mixed: rt.Tlas, tmp_path: Path) -> None:
    answers = trace(device, mixed, **wrong_rays())
    assert answers["hit"]["kind"].tolist() == [TRIANGLE] + [NONE] * 11
    given = given_to_vulkan(device, mixed, tmp_path)
    assert given[0].tolist() == pytest.approx([0, *CENTER, 0, 0, -1])
    assert given[1:].tolist() == [[0, 0, 0, 0, 0, 0, 1]] * 11


def test_the_guide_says_which_rays_are_checked() -> None:
    """The renderer's own rays go to Vulkan as they are, and whoever debugs a shader must know."""
    assert "ray_query.glsl" not in (glsl_root() / "scene/trace.glsl").read_text()
    guide = (Path(__file__).parents[2] / "docs/ray_tracing.md").read_text(encoding="utf-8")
    assert "`RAY_QUERY_DEBUG` does not see rays traced through `scene/trace.glsl`" in guide
    assert "There is no `scene.trace(rays)`, since a scene knows no device" in guide


def test_skipping_primitives_is_declared() -> None:
    """SPIR-V has the flags only with RayTraversalPrimitiveCullingKHR, which every device with ray queries takes."""
    words = np.frombuffer(compile_shader("passes/probe.comp", root=GLSL), np.uint32)
    found, at = set(), 5
    while at < len(words):
        if words[at] & 0xFFFF == 17:  # OpCapability
            found.add(int(words[at + 1]))
        at += int(words[at] >> 16)
    assert {4472, 4478} <= found  # RayQueryKHR, RayTraversalPrimitiveCullingKHR


@pytest.mark.parametrize("flags", [0x3, 0x41, 0x82, 0xC0, 0x30, 0x110, 0x300])
def test_contradicting_flags(device: Device, mixed: rt.Tlas, flags: int) -> None:
    with pytest.raises(SolariError, match="contradictory ray flags"):
        trace(device, mixed, CENTER, flags=flags, header=rt.RAY_QUERY_DEBUG)


# ---- undefined behaviour, caught --------------------------------------------------------------------

CASE = """
#version 460
#extension GL_EXT_scalar_block_layout : require
#include "scene/ray_query.glsl"
layout(local_size_x = 4) in;
layout(set = 0, binding = 0) uniform accelerationStructureEXT tlas;
layout(set = 1, binding = 0, scalar) buffer KindsBlock { uint at[]; } kinds;
RayDesc down(float x) {
    return RayDesc(RAY_FLAG_NONE, 0xFFu, 1.0, 9.0, vec3(x + 0.6, 0.3, 5.0), vec3(0.0, 0.0, -1.0));
}
void main() {
    if (gl_GlobalInvocationID.x != 2u) { return; }
    RayIntersection hit = ray_query_no_intersection();
    vec3 corners[3] = vec3[3](vec3(0.0), vec3(0.0), vec3(0.0));
    RAY_QUERY(query);
    @
    kinds.at[0] = hit.kind + uint(corners[0].x > 1e30);
}
"""
START = "rayQueryInitialize(query, tlas, down({})); "
CASES = {
    0: [
        "hit = rayQueryGetCommittedIntersection(query);",
        START.format("0.0") + "hit = rayQueryGetCommittedIntersection(query);",
        START.format("0.0") + "hit = rayQueryGetCandidateIntersection(query);",
        START.format("0.0") + "rayQueryProceed(query); " + START.format("0.0")
        + "hit = rayQueryGetCommittedIntersection(query);",
    ],
    1: [START.format("2.0") + "rayQueryProceed(query); hit = rayQueryGetCommittedIntersection(query);"],
    2: [START.format("0.0") + "rayQueryProceed(query); hit = rayQueryGetCandidateIntersection(query);"],
    6: ["rayQueryProceed(query);"],
    7: [START.format("2.0") + "rayQueryProceed(query); rayQueryGenerateIntersection(query, 4.5);"],
    8: [
        START.format("6.0") + "rayQueryProceed(query); rayQueryGenerateIntersection(query, 0.5);",
        START.format("6.0") + "rayQueryProceed(query); rayQueryGenerateIntersection(query, 9.5);",
        START.format("6.0") + "rayQueryProceed(query); "
        "rayQueryGenerateIntersection(query, uintBitsToFloat(0x7FC00000u));",
    ],
    9: [
        "rayQueryGenerateIntersection(query, 4.5);",
        START.format("8.0") + "rayQueryProceed(query); rayQueryGenerateIntersection(query, 4.5);",
    ],
    10: [START.format("6.0") + "rayQueryProceed(query); rayQueryConfirmIntersection(query);"],
    11: [
        "rayQueryConfirmIntersection(query);",
        START.format("0.0") + "rayQueryProceed(query); rayQueryConfirmIntersection(query);",
    ],
    12: ["rayQueryTerminate(query);"],
}
POSITION_CASES = {
    3: [START.format("2.0") + "rayQueryProceed(query); corners = getCommittedHitVertexPositions(query);"],
    4: [START.format("0.0") + "rayQueryProceed(query); corners = getCandidateHitVertexPositions(query);"],
    5: [
        START.format("8.0") + "rayQueryProceed(query); corners = getCommittedHitVertexPositions(query);",
        START.format("6.0") + "rayQueryProceed(query); corners = getCandidateHitVertexPositions(query);",
    ],
    0: [START.format("0.0") + "corners = getCommittedHitVertexPositions(query);"],
}


def run_case(device: Device, tlas: rt.Tlas, folder: Path, code: str, header: str = rt.RAY_QUERY_DEBUG) -> Any:
    (folder / "passes").mkdir(exist_ok=True)
    (folder / "passes/case.comp").write_text(CASE.replace("@", code).lstrip())
    stage = Stage("case", buffers={"kinds": 1, **rt.FAULT_BUFFERS}, passes=[Pass("case", 4, header=header)])
    with Frame(device, [stage], external={"tlas": tlas}, glsl_root=folder) as frame:
        frame.submit()
        return frame["kinds"][0], rt.ray_query_faults(frame), frame


@pytest.mark.parametrize(("rule", "code"), [(rule, code) for rule, codes in CASES.items() for code in codes])
def test_a_broken_rule_is_counted_and_harmless(
    device: Device, mixed: rt.Tlas, tmp_path: Path, rule: int, code: str
) -> None:
    kind, faults, _ = run_case(device, mixed, tmp_path, code)
    assert [fault.rule for fault in faults] == [rt.RULES[rule]]
    assert faults[0].count == 1
    assert faults[0].invocation == (2, 0, 0)
    assert kind == NONE


def test_a_right_query_breaks_no_rule(device: Device, mixed: rt.Tlas, tmp_path: Path) -> None:
    code = START.format("2.0") + (
        "while (rayQueryProceed(query)) { hit = rayQueryGetCandidateIntersection(query); "
        "rayQueryConfirmIntersection(query); } rayQueryProceed(query); hit = rayQueryGetCommittedIntersection(query);"
    )
    kind, faults, _ = run_case(device, mixed, tmp_path, code)
    assert kind == TRIANGLE
    assert faults == []


# ---- vertex return ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def fetching(any_device: None) -> Any:
    """A device that returns vertices; the validation layer installed here is older than the extension."""
    with Device(validation=False) as device:
        if not device.has_position_fetch:
            pytest.skip("this device has no VK_KHR_ray_tracing_position_fetch")
        yield device


FETCH = "#define RAY_QUERY_VERTEX_RETURN\n"


def make_mixed(device: Device) -> rt.Tlas:
    geometries = [rt.Triangles(quad()), rt.Triangles(quad(), opaque=False), rt.Aabbs([[0, 0, 0, 1, 1, 1]])]
    blases = [rt.create_blas(device, [geometry]) for geometry in geometries]
    tlas = rt.create_tlas(device, 3)
    entries = [rt.BlasBuildEntry(blas, [geometry]) for blas, geometry in zip(blases, geometries, strict=True)]
    items = [rt.TlasInstance(blas, shifted(x)) for blas, x in zip(blases, (0, 2, 6), strict=True)]
    rt.build_acceleration_structures(device, entries, [rt.TlasPackage(tlas, items)])
    return tlas


@pytest.mark.parametrize("header", [FETCH, FETCH + rt.RAY_QUERY_DEBUG], ids=["release", "debug"])
def test_vertices_of_a_hit(fetching: Any, header: str) -> None:
    tlas = make_mixed(fetching)
    answers = trace(fetching, tlas, [[0.6, 0.3, 5], [2.3, 0.6, 5], [9, 9, 9]], header=header)
    assert np.array_equal(answers["positions"][0], quad()[:3])
    assert np.array_equal(answers["positions"][1], quad()[3:])
    assert (answers["positions"][2] == 0).all()


@pytest.mark.parametrize(("rule", "code"), [(rule, code) for rule, codes in POSITION_CASES.items() for code in codes])
def test_broken_rules_of_vertex_return(fetching: Any, tmp_path: Path, rule: int, code: str) -> None:
    _, faults, _ = run_case(fetching, make_mixed(fetching), tmp_path, code, FETCH + rt.RAY_QUERY_DEBUG)
    assert [fault.rule for fault in faults] == [rt.RULES[rule]]


def test_the_flag_says_what_the_device_can(device: Device) -> None:
    assert device.has_position_fetch == ("rayTracingPositionFetch" in device.features)
