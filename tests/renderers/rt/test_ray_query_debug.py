"""scene/ray_query.glsl: each broken rule of the document is harmless, and counted by the debug build.

The conformance suite proves queries that break no rule, and invalid rays.
"""

from __future__ import annotations

import pytest
from support.scenes import quad_corners, translation
from support.seeded_bugs import Bug, seeded

from solari_vk import rt
from solari_vk.base.errors import SolariError
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Frame, Pass, Stage
from solari_vk.gpu.frame.ray_query_faults import FAULTS

SHADER = """#version 460
#extension GL_EXT_scalar_block_layout : require
#include "scene/ray_query.glsl"
layout(local_size_x = 4) in;
layout(constant_id = 0) const uint CASE = 0u;
layout(set = 0, binding = 0) uniform accelerationStructureEXT tlas;
layout(set = 1, binding = 0, scalar) buffer KindsBlock { uint at[]; } kinds;
RayDesc down(float x, uint flags) { return RayDesc(flags, 0xFFu, 1.0, 9.0, vec3(x, 0.3, 5.0), vec3(0.0, 0.0, -1.0)); }
void main() {
    if (gl_GlobalInvocationID.x != 2u) { return; }
    RayIntersection hit = ray_query_no_intersection();
    vec3 corners[3] = vec3[3](vec3(0.0), vec3(0.0), vec3(0.0));
    RAY_QUERY(query);
    switch (CASE) {
%s
    }
    kinds.at[0] = hit.kind + uint(corners[0].x > 1e30);
}
"""
# The x at which rays start, by what they hit.
OPAQUE = 0.6
GLASS = 2.6
BOX = 6.6
NOTHING = 8.6


def start(x, flags=0):
    return f"rayQueryInitialize(query, tlas, down({x}, {flags}u)); "


def proceed(x):
    return start(x) + "rayQueryProceed(query); "


COMMITTED = "hit = rayQueryGetCommittedIntersection(query);"
CANDIDATE = "hit = rayQueryGetCandidateIntersection(query);"
GENERATE = "rayQueryGenerateIntersection(query, {});"
CONFIRM = "rayQueryConfirmIntersection(query);"
RIGHT = start(GLASS) + (
    f"while (rayQueryProceed(query)) {{ {CANDIDATE} {CONFIRM} }} rayQueryProceed(query); {COMMITTED}"
)
CONTRADICTIONS = (0x3, 0x41, 0x82, 0xC0, 0x30, 0x110, 0x300)
CASES = [  # the rule and what breaks it
    ("get_before_proceed", COMMITTED),
    ("get_before_proceed", start(OPAQUE) + COMMITTED),
    ("get_before_proceed", start(OPAQUE) + CANDIDATE),
    ("get_before_proceed", proceed(OPAQUE) + start(OPAQUE) + COMMITTED),
    ("committed_while_candidate", proceed(GLASS) + COMMITTED),
    ("candidate_while_committed", proceed(OPAQUE) + CANDIDATE),
    ("proceed_before_initialize", "rayQueryProceed(query);"),
    ("generate_of_no_aabb", proceed(GLASS) + GENERATE.format(4.5)),
    *(("generate_out_of_range", proceed(BOX) + GENERATE.format(t)) for t in (0.5, 9.5, "uintBitsToFloat(0x7FC00000u)")),
    ("generate_without_candidate", GENERATE.format(4.5)),
    ("generate_without_candidate", proceed(NOTHING) + GENERATE.format(4.5)),
    ("confirm_of_no_triangle", proceed(BOX) + CONFIRM),
    ("confirm_without_candidate", CONFIRM),
    ("confirm_without_candidate", proceed(OPAQUE) + CONFIRM),
    ("terminate_before_initialize", "rayQueryTerminate(query);"),
    *(
        ("contradicting_flags", start(OPAQUE, flags) + "rayQueryProceed(query); " + COMMITTED)
        for flags in CONTRADICTIONS
    ),
]
COMMITTED_CORNERS = "corners = getCommittedHitVertexPositions(query);"
CANDIDATE_CORNERS = "corners = getCandidateHitVertexPositions(query);"
POSITION_CASES = [
    ("committed_positions_while_candidate", proceed(GLASS) + COMMITTED_CORNERS),
    ("candidate_positions_while_committed", proceed(OPAQUE) + CANDIDATE_CORNERS),
    ("positions_of_no_triangle", proceed(NOTHING) + COMMITTED_CORNERS),
    ("positions_of_no_triangle", proceed(BOX) + CANDIDATE_CORNERS),
    ("get_before_proceed", start(OPAQUE) + COMMITTED_CORNERS),
]
FETCH = "#define RAY_QUERY_VERTEX_RETURN\n"


@pytest.fixture(scope="module")
def run_case(tmp_path_factory):
    """run_case(device, number, cases=CASES) -> the kind of the hit, and the counted faults. RIGHT is the last case."""
    folder = tmp_path_factory.mktemp("cases")
    made = []
    tops = {}
    (folder / "passes").mkdir()
    for name, cases in (("cases", CASES), ("position_cases", POSITION_CASES)):
        lines = [f"        case {i}u: {code} break;" for i, code in enumerate([*(code for _, code in cases), RIGHT])]
        (folder / f"passes/{name}.comp").write_text(SHADER % "\n".join(lines))

    def make_tlas(device):
        geometries = [
            rt.Triangles(quad_corners()),
            rt.Triangles(quad_corners(), opaque=False),
            rt.Aabbs([[0, 0, 0, 1, 1, 1]]),
        ]
        blases = [rt.create_blas(device, [geometry]) for geometry in geometries]
        tlas = rt.create_tlas(device, 3)
        entries = [rt.BlasBuildEntry(blas, [geometry]) for blas, geometry in zip(blases, geometries, strict=True)]
        items = [rt.TlasInstance(blas, translation(x)) for blas, x in zip(blases, (0, 2, 6), strict=True)]
        rt.build_acceleration_structures(device, entries, [rt.TlasPackage(tlas, items)])
        made.extend([*blases, tlas])
        return tlas

    def run(device, number, cases=CASES, debug=rt.RAY_QUERY_DEBUG):
        if device not in tops:
            tops[device] = make_tlas(device)
        name, header = ("cases", "") if cases is CASES else ("position_cases", FETCH)
        one = Pass(name, 4, header=header + debug, constants={"CASE": number})
        stage = Stage("case", buffers={"kinds": 1, **(rt.FAULT_BUFFERS if debug else {})}, passes=[one])
        with Frame(device, [stage], external={"tlas": tops[device]}, glsl_root=folder) as frame:
            frame.submit()
            faults = rt.ray_query_faults(frame) if debug else []
            if faults:
                with pytest.raises(SolariError, match=r"ray queries: .* \(1 times, first in invocation"):
                    rt.check_ray_queries(frame)
            return int(frame["kinds"][0]), faults

    yield run
    for item in made:
        item.destroy()


def check_cases(run_case, device, cases, only=None):
    """Assert that each case, or each that breaks one rule, is counted once and hits nothing."""
    for number, (rule, code) in enumerate(cases):
        if only in (None, rule):
            kind, faults = run_case(device, number, cases)
            assert [fault.rule for fault in faults] == [FAULTS[rule]], code
            assert (faults[0].count, faults[0].invocation, kind) == (1, (2, 0, 0), rt.IntersectionKind.NONE), code


@pytest.mark.parametrize("rule", dict.fromkeys(rule for rule, _ in CASES))
def test_a_broken_rule_is_counted_and_harmless(run_case, device, rule):
    check_cases(run_case, device, CASES, rule)


def test_broken_rules_are_harmless_in_all_builds(run_case, device):
    for number in range(len(CASES)):
        assert run_case(device, number, debug="") == (rt.IntersectionKind.NONE, []), CASES[number]
    assert run_case(device, len(CASES), debug="") == (rt.IntersectionKind.TRIANGLE, [])


def test_a_right_query_breaks_no_rule(run_case, device):
    assert run_case(device, len(CASES)) == (rt.IntersectionKind.TRIANGLE, [])


def test_broken_rules_of_vertex_return(run_case, any_device):
    """Without validation, for the layer installed here is older than the extension."""
    with Device(validation=False) as fetching:
        assert fetching.has_position_fetch == ("rayTracingPositionFetch" in fetching.features)
        if not fetching.has_position_fetch:
            pytest.skip("this device has no VK_KHR_ray_tracing_position_fetch")
        check_cases(run_case, fetching, POSITION_CASES)


UNCHECKED = (
    "committed_while_candidate",
    "candidate_while_committed",
    "contradicting_flags",
    "get_before_proceed",
    "proceed_before_initialize",
    "generate_of_no_aabb",
    "generate_out_of_range",
    "generate_without_candidate",
    "confirm_of_no_triangle",
    "confirm_without_candidate",
    "terminate_before_initialize",
)


@pytest.mark.parametrize(
    "rule", [UNCHECKED[0], *(pytest.param(rule, marks=pytest.mark.slow) for rule in UNCHECKED[1:])]
)
def test_an_unchecked_rule_is_noticed(run_case, device, rule):
    unchecked = f"return correct(kept || fault == FAULT_{rule.upper()}, fault);"
    with seeded(Bug("scene/ray_query_state.glsl", "ray_query_rule", unchecked)), pytest.raises(AssertionError):
        check_cases(run_case, device, CASES, rule)


# ---- hits behind the committed one ------------------------------------------------------------------

COUNTING = """#version 460
#extension GL_EXT_ray_query : require
uint generated = 0u;
#define rayQueryGenerateIntersectionEXT(query, t) generated++; rayQueryGenerateIntersectionEXT(query, t)
#include "scene/ray_query.glsl"
layout(local_size_x = 1) in;
layout(set = 0, binding = 0) uniform accelerationStructureEXT tlas;
layout(set = 1, binding = 0) buffer CountsBlock { uint at[]; } counts;
void main() {
    for (int way = 0; way < 3; way++) {
        RAY_QUERY(query);
        rayQueryInitialize(query, tlas, RayDesc(0u, 0xFFu, 1.0, 99.0, vec3(0.3, 0.3, 9.0), vec3(0.0, 0.0, -1.0)));
        generated = 0u;
        for (int box = 0; rayQueryProceed(query); box++) {
            rayQueryGenerateIntersection(query, 50.0 + float(box * (way - 1)));
        }
        counts.at[way] = generated;
    }
}
"""
EVERY_HIT = Bug("scene/ray_query.glsl", "ray_query_generate", "rayQueryGenerateIntersectionEXT(query, hit_t);")


@pytest.mark.parametrize("bugs", [(), (EVERY_HIT,)], ids=["right", "bug"])
def test_no_hit_is_generated_behind_the_committed_one(device, world, tmp_path, bugs):
    """Vulkan leaves undefined what such a call does: Mesa ignores it, so that hits alone can't tell. Counts the calls
    where the hits of three boxes come nearer, stay, and go away."""
    (tmp_path / "passes").mkdir()
    (tmp_path / "passes/counting.comp").write_text(COUNTING)
    boxes = [rt.Aabbs([[0, 0, 2 * i, 1, 1, 2 * i + 1] for i in range(3)])]
    blas, tlas = world.blas(boxes), world.tlas()
    world.build([rt.BlasBuildEntry(blas, boxes)], [rt.TlasPackage(tlas, [rt.TlasInstance(blas)])])
    stage = Stage("counting", buffers={"counts": 3}, passes=[Pass("counting", 1)])
    with seeded(*bugs), Frame(device, [stage], external={"tlas": tlas}, glsl_root=tmp_path) as frame:
        frame.submit()
        assert (frame["counts"].tolist() == [3, 3, 1]) == (not bugs)
