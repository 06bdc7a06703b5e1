"""The rules about poses can fail: seeded bugs in what moves vertices, and in motion vectors."""

from __future__ import annotations

import functools

import pytest
from seeded_bugs import expect_noticed, rules_broken_by, rules_of

from solari_vk.conformance import pose_checks as checks

DEFORM, GBUFFER = "scene/deform.comp", "passes/gbuffer/gbuffer.glsl"
SKIN, MORPH, BOTH, NORMALS, MOTION, REST = (
    rule.name for rule in (checks.SKIN, checks.MORPH, checks.BOTH, checks.NORMALS, checks.MOTION, checks.REST)
)
NORMALS_CHECK = functools.partial(checks.measure_normals, way="traced")
MOTION_CHECK = functools.partial(checks.measure_motion, way="traced")
BUGS = {
    "two joints a vertex": (checks.measure_vertices, [SKIN], DEFORM, "i < mesh.influence_count", "i < 2u"),
    "weights aren't counted": (checks.measure_vertices, [MORPH], DEFORM, "position += added.weight * load",
                               "position += load"),
    "joints before targets": (
        checks.measure_vertices, [BOTH], DEFORM, "position = joint * vec4(position, 1.0);",
        "vec3 rest = load(mesh.rest_positions, 3u * vertex);\n"
        "        position = joint * vec4(rest, 1.0) + position - rest;"),
    "normals move as directions": (
        NORMALS_CHECK, [NORMALS], DEFORM,
        "mat3(cross(joint[1], joint[2]), cross(joint[2], joint[0]), cross(joint[0], joint[1])) * normal",
        "mat3(joint) * normal"),
    "poses without motion": (MOTION_CHECK, [MOTION], GBUFFER, "if (changes_pose(mesh)) {", "if (false) {"),
    "small motion everywhere": (MOTION_CHECK, [REST], GBUFFER, "camera_rests()) { return vec2(0.0); }",
                                "camera_rests()) { return vec2(1e-4); }"),
}  # fmt: skip


def test_every_rule_has_a_bug():
    assert rules_of(checks) == rules_broken_by(BUGS)


@pytest.mark.parametrize("name", BUGS)
def test_bug_is_noticed(device, name):
    expect_noticed(device, BUGS[name])
