"""The debug build of scene/ray_query.glsl: each broken rule of the document is counted and harmless.

The conformance suite proves queries that break no rule, and invalid rays.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from support.seeded_bugs import Bug, seeded
from support.structures import quad, shifted

from solari_vk import rt
from solari_vk.errors import SolariError
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
OPAQUE, GLASS, BOX, NOTHING = 0.6, 2.6, 6.6, 8.6  # the x at which rays start, by what they hit


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
def shader_folder(tmp_path_factory):
    """A GLSL root with a shader of CASES and one of POSITION_CASES; RIGHT is the last case of both."""
    folder = tmp_path_factory.mktemp("cases")
    (folder / "passes").mkdir()
    for name, cases in (("cases", CASES), ("position_cases", POSITION_CASES)):
        codes = [*(code for _, code in cases), RIGHT]
        lines = [f"        case {i}u: {code} break;" for i, code in enumerate(codes)]
        (folder / f"passes/{name}.comp").write_text(SHADER % "\n".join(lines))
    return folder


@pytest.fixture(scope="module")
def run_case(shader_folder):
    """run_case(device, number, name="cases") -> the kind of the hit, and the counted faults."""
    made = []
    tops = {}

    def make_tlas(device):
        geometries = [rt.Triangles(quad()), rt.Triangles(quad(), opaque=False), rt.Aabbs([[0, 0, 0, 1, 1, 1]])]
        blases = [rt.create_blas(device, [geometry]) for geometry in geometries]
        tlas = rt.create_tlas(device, 3)
        entries = [rt.BlasBuildEntry(blas, [geometry]) for blas, geometry in zip(blases, geometries, strict=True)]
        items = [rt.TlasInstance(blas, shifted(x)) for blas, x in zip(blases, (0, 2, 6), strict=True)]
        rt.build_acceleration_structures(device, entries, [rt.TlasPackage(tlas, items)])
        made.extend([*blases, tlas])
        return tlas

    def run(device, number, name="cases"):
        if device not in tops:
            tops[device] = make_tlas(device)
        header = rt.RAY_QUERY_DEBUG if name == "cases" else FETCH + rt.RAY_QUERY_DEBUG
        one = Pass(name, 4, header=header, constants={"CASE": number})
        stage = Stage("case", buffers={"kinds": 1, **rt.FAULT_BUFFERS}, passes=[one])
        with Frame(device, [stage], external={"tlas": tops[device]}, glsl_root=shader_folder) as frame:
            frame.submit()
            faults = rt.ray_query_faults(frame)
            if faults:
                with pytest.raises(SolariError, match=r"ray queries: .* \(1 times, first in invocation"):
                    rt.check_ray_queries(frame)
            return int(frame["kinds"][0]), faults

    yield run
    for item in made:
        item.destroy()


def check_case(run_case, device, number, name="cases"):
    cases = CASES if name == "cases" else POSITION_CASES
    kind, faults = run_case(device, number, name)
    assert [fault.rule for fault in faults] == [FAULTS[cases[number][0]]]
    assert faults[0].count == 1
    assert faults[0].invocation == (2, 0, 0)
    assert kind == rt.IntersectionKind.NONE


def check_rule(run_case, device, rule):
    for number, (broken, _) in enumerate(CASES):
        if broken == rule:
            check_case(run_case, device, number)


@pytest.mark.parametrize("number", range(len(CASES)), ids=lambda number: f"{number}-{CASES[number][0]}")
def test_a_broken_rule_is_counted_and_harmless(run_case, device, number):
    check_case(run_case, device, number)


def test_a_right_query_breaks_no_rule(run_case, device):
    assert run_case(device, len(CASES)) == (rt.IntersectionKind.TRIANGLE, [])


@pytest.fixture(scope="module")
def fetching(any_device):
    """A device that returns vertices; the validation layer installed here is older than the extension."""
    with Device(validation=False) as device:
        if not device.has_position_fetch:
            pytest.skip("this device has no VK_KHR_ray_tracing_position_fetch")
        yield device


@pytest.mark.parametrize("number", range(len(POSITION_CASES)))
def test_broken_rules_of_vertex_return(run_case, fetching, number):
    check_case(run_case, fetching, number, "position_cases")


def test_the_flag_says_what_the_device_can(device):
    assert device.has_position_fetch == ("rayTracingPositionFetch" in device.features)


def test_the_guide_says_which_rays_are_checked():
    """The renderer's own rays go to Vulkan unchecked, which users who debug a shader must know."""
    root = Path(__file__).parents[2]
    assert "ray_query.glsl" not in (root / "glsl/scene/trace.glsl").read_text()
    guide = (root / "docs/ray_tracing.md").read_text(encoding="utf-8")
    assert "`RAY_QUERY_DEBUG` doesn't check rays traced with `scene/trace.glsl`" in guide
    assert "There is no `scene.trace(rays)`, because a scene isn't tied to a device" in guide


# ---- seeded bugs ------------------------------------------------------------------------------------

UNCHECKED = ("committed_while_candidate", "candidate_while_committed", "contradicting_flags", "get_before_proceed",
             "proceed_before_initialize", "generate_of_no_aabb", "generate_out_of_range", "generate_without_candidate",
             "confirm_of_no_triangle", "confirm_without_candidate", "terminate_before_initialize")  # fmt: skip


@pytest.mark.parametrize("rule", [rule if rule == UNCHECKED[0] else pytest.param(rule, marks=pytest.mark.slow)
                                  for rule in UNCHECKED])  # fmt: skip
def test_an_unchecked_rule_is_noticed(run_case, device, rule):
    bug = Bug("scene/ray_query_debug.glsl", "ray_query_rule",
              f"return correct(kept || fault == FAULT_{rule.upper()}, fault);")  # fmt: skip
    with seeded(bug), pytest.raises(AssertionError):
        check_rule(run_case, device, rule)
