"""The rules of discarded calls and of traceRay hold, and notice bugs in the shaders."""

from __future__ import annotations

import pytest
from red_rules import expect_red, failing
from support.seeded_bugs import Bug

from solari_vk.lab.conformance import discarded_checks

STATE = "scene/ray_query_state.glsl"
AT_ANY_TIME = "if (record.phase >= RAY_QUERY_AT_CANDIDATE) "
ALL_FLAGS = Bug("scene/ray_desc.glsl", "ray_query_flags_agree", "return true;")
BUGS = {
    "rayQueryProceed before": Bug(
        STATE, "ray_query_proceed", "return record.phase == RAY_QUERY_UNKNOWN || correct(query, record);"
    ),
    "rayQueryConfirmIntersection without": Bug(
        STATE, "ray_query_confirm_checked", AT_ANY_TIME + "{ rayQueryConfirmIntersectionEXT(query); }"
    ),
    "with contradicting flags": ALL_FLAGS,
    "out of range is": Bug(STATE, "ray_query_generate_checked", AT_ANY_TIME + "{ ray_query_generate(query, hit_t); }"),
    "rayQueryTerminate before": Bug(
        STATE, "ray_query_terminate_checked", AT_ANY_TIME + "{ ray_query_generate(query, 1.5); }"
    ),
    "after rayQueryTerminate": Bug(STATE, "ray_query_terminate_checked", ""),
    "give zeros": Bug(STATE, "ray_query_stands", "return record.phase >= RAY_QUERY_AT_CANDIDATE;"),
}
NESTED_BUGS = {
    "closest-hit and miss": Bug("passes/conformance/nested.rmiss", "main", "found.misses += 1u;"),
    "of an invalid ray": ALL_FLAGS,
}


def test_calls_are_discarded_and_hit_shaders_trace(shaders, ray_shaders):
    assert not failing(discarded_checks.measure_discarded(shaders))
    assert not failing(discarded_checks.measure_nested(ray_shaders))


@pytest.mark.parametrize(
    "rule", [rule if rule == "give zeros" else pytest.param(rule, marks=pytest.mark.slow) for rule in BUGS]
)
def test_bugs_in_queries_are_noticed(patched, rule):
    with patched(BUGS[rule]) as shaders:
        expect_red(discarded_checks.measure_discarded(shaders), rule)


@pytest.mark.parametrize("rule", NESTED_BUGS)
def test_bugs_in_nested_rays_are_noticed(patched, ray_shaders, rule):
    with patched(NESTED_BUGS[rule], device=ray_shaders.device) as shaders:
        expect_red(discarded_checks.measure_nested(shaders), rule)
