"""The rules of ray pipelines fail with seeded bugs: in rays, instance records and shaders."""

from __future__ import annotations

import numpy as np
import pytest
from red_rules import expect_red, failing, masked
from support.seeded_bugs import Bug

from solari_vk.conformance import bulk_checks, probe_actions, ray_pipeline_checks, ray_probe_checks, structure_checks
from solari_vk.conformance.probe_table import PROBES
from solari_vk.conformance.probes import INSTANCES, SHAPES
from solari_vk.conformance.ray_probe_checks import ASKED, rule_of
from solari_vk.conformance.shader_runner import ShaderRunner
from solari_vk.conformance.worlds import World
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.ray_query_constants import RayFlags


@pytest.fixture(scope="module")
def ray_device(any_device):
    """A device that traces by ray pipelines, under validation."""
    with Device(validation=True, rays="pipeline") as opened:
        yield opened
        opened.wait_idle()


@pytest.fixture(scope="module")
def rays(ray_device):
    """The suite's shaders on it."""
    with ShaderRunner(ray_device) as made:
        yield made


def probe(shaders, *, rays=None, records=None, shapes=SHAPES):
    """All measurements of the probes with damaged rays, instance records or shapes."""
    with World(shaders.device, shapes, list(INSTANCES.values()), damage=records) as world:
        return list(ray_probe_checks.measure_probes(shaders, world, damage=rays))


def test_probes_pass_and_all_but_one_are_asked(rays):
    assert [item.label for item in PROBES if item not in ASKED] == ["ended at once"]
    assert not failing(probe(rays))


def test_devices_without_primitive_culling_are_asked_the_rest(rays):
    asked = [item for item in ASKED if not ray_probe_checks.culls(item)]
    assert len(ASKED) - len(asked) == 4
    with World(rays.device, SHAPES, list(INSTANCES.values())) as world:
        assert not failing(ray_probe_checks.measure_probes(rays, world, asked, culling=False))


@pytest.mark.parametrize("flag", RayFlags, ids=lambda flag: flag.name)
def test_ignored_flag_is_noticed(rays, flag):
    (rule,) = {rule_of(item).name for item in ASKED if item.rule.name.startswith(f"{flag.name}:")}

    def drop(sent):
        sent["flags"] &= ~np.uint32(flag)

    expect_red(probe(rays, rays=drop), rule)


def changing(**values):
    def damage(sent):
        for field, value in values.items():
            sent[field] = value

    return damage


def without_action(bits):
    def damage(sent):
        sent["action"] &= ~np.uint32(bits)

    return damage


def normalized(sent):
    sent["direction"] /= np.linalg.norm(sent["direction"], axis=1, keepdims=True)


RAY_BUGS = {
    "mask dropped": (changing(cull_mask=0xFF), ["cullMask"]),
    "Tmin dropped": (changing(t_min=0.0), ["Tmin", "tell the traced ray"]),
    "Tmax dropped": (changing(t_max=np.inf), ["Tmax"]),
    "direction normalized": (normalized, ["direction of traceRayEXT", "gl_HitTEXT in closest-hit"]),
    "all ignored": (without_action(probe_actions.CONFIRM | probe_actions.CONFIRM_ODD), ["ignoreIntersectionEXT"]),
    "none ignored": (lambda sent: np.bitwise_or(sent["action"], probe_actions.CONFIRM, out=sent["action"]),
                     ["ignoreIntersectionEXT", "gl_RayFlagsNoneEXT"]),
    "nothing reported": (without_action(probe_actions.GENERATE_AT | probe_actions.GENERATE_SPHERE),
                         ["reportIntersectionEXT: the nearest"]),
    "nothing terminated": (without_action(probe_actions.TERMINATE), ["terminateRayEXT"]),
}  # fmt: skip


@pytest.mark.parametrize("name", RAY_BUGS)
def test_damaged_ray_is_noticed(rays, name):
    damage, rules = RAY_BUGS[name]
    expect_red(probe(rays, rays=damage), *rules)


def transposed(records):
    records["transform"][:, :, :3] = records["transform"][:, :, :3].transpose(0, 2, 1).copy()


def swapped(records):
    records[:2] = records[1::-1]


def all_active(records):
    records["blas_address"][records["blas_address"] == 0] = records["blas_address"][0]


RECORD_BUGS = {
    "custom index of 23 bits": (masked("custom_index_and_mask", 0xFF7FFFFF), ["gl_InstanceCustomIndexEXT of instances",
                                                                             "gl_InstanceCustomIndexEXT in closest"]),
    "no instance flags": (masked("sbt_offset_and_flags", 0xFFFFFF), ["FLIP_FACING", "FACING_CULL_DISABLE",
                                                                    "of an instance override its geometry"]),
    "matrix transposed": (transposed, ["gl_WorldToObjectEXT of moved"]),
    "two instances swapped": (swapped, ["gl_InstanceID in closest-hit"]),
    "inactive hit": (all_active, ["without a structure"]),
}  # fmt: skip


@pytest.mark.parametrize("name", RECORD_BUGS)
def test_damaged_instance_record_is_noticed(rays, name):
    damage, rules = RECORD_BUGS[name]
    expect_red(probe(rays, records=damage), *rules)


def answered(file, damage):
    """A seeded bug: after a shader's main, its answer is damaged."""
    return Bug(f"passes/conformance/{file}", "main", f"correct(); {damage.replace('FOUND', 'RAY_ANSWER.committed')}")


def shader_bugs(file, where, found):
    """A bug for each value that a shader reads; `found` is where it keeps them."""
    damages = {
        "gl_InstanceCustomIndexEXT": "FOUND.custom_data = FOUND.instance;",
        "gl_InstanceID": "FOUND.instance = FOUND.custom_data;",
        "gl_GeometryIndexEXT": "FOUND.geometry = FOUND.primitive;",
        "gl_PrimitiveID": "FOUND.primitive = FOUND.geometry;",
        "gl_ObjectToWorldEXT": "FOUND.object_to_world = FOUND.world_to_object;",
        "gl_ObjectRayDirectionEXT": "FOUND.object_direction = gl_WorldRayDirectionEXT;",
        "FrontFacingTriangleEXT": "FOUND.front_face ^= 1u;",
        "hitAttributeEXT of triangles": "FOUND.barycentrics = FOUND.barycentrics.yx;",
        "gl_HitTEXT": "FOUND.t *= 1.00001;",
    }
    return {f"{name} {where}": answered(file, damage.replace("FOUND", found)) for name, damage in damages.items()}


SHADER_BUGS = {  # parts of the name of the rule that must fail, and the bug
    **shader_bugs("probe_triangle.rchit", "in closest-hit", "RAY_ANSWER.committed"),
    "tell the traced ray": answered("probe_triangle.rchit", "RAY_ANSWER.flags = 99u;"),
    "whose payload the ray generation shader gets": answered("probe_box.rchit", "ended = ENDED_NOWHERE;"),
    "one closest-hit or one miss shader": answered("probe.rmiss", "atomicAdd(RAY_ANSWER.misses, 1u);"),
    "intersection shaders run for each AABB": answered("probe_box.rint", "RAY_ANSWER.candidate.kind = 0u;"),
}
QUICK = ("gl_HitTEXT in closest-hit",)


@pytest.mark.parametrize("rule", [rule if rule in QUICK else pytest.param(rule, marks=pytest.mark.slow)
                                  for rule in SHADER_BUGS])  # fmt: skip
def test_bug_in_a_shader_is_noticed(patched, ray_device, rule):
    with patched(SHADER_BUGS[rule], device=ray_device) as shaders:
        expect_red(probe(shaders), rule)


def lowered(field):
    """Damage: values of a field that need more than four bits are one more."""

    def damage(sent):
        sent[field] += sent[field] > 15

    return damage


@pytest.mark.parametrize(("damage", "rule"), [
    (changing(offset=0), "hit records"), (changing(stride=0), "hit records"), (lowered("offset"), "have four bits"),
    (lowered("stride"), "have four bits"), (changing(miss=0), "miss records"),
])  # fmt: skip
def test_wrong_records_are_noticed(rays, damage, rule):
    assert not failing(ray_pipeline_checks.measure_records(rays))
    expect_red(ray_pipeline_checks.measure_records(rays, damage), rule)


@pytest.mark.slow
def test_wrong_launches_are_noticed(rays, patched):
    assert not failing(ray_pipeline_checks.measure_launches(rays))
    bug = Bug("passes/conformance/launch.rmiss", "main", "told = Told(gl_LaunchIDEXT.yxz, gl_LaunchSizeEXT);")
    with patched(bug, device=rays.device) as shaders:
        expect_red(ray_pipeline_checks.measure_launches(shaders), "gl_LaunchIDEXT", "TraceRaysIndirect")


REPORT_BUGS = {
    "get the attributes": Bug("passes/conformance/report.rchit", "main",
                              "correct(); found.attributes = attributes.yxzw;"),
    "nearest accepted one is hit": Bug("passes/conformance/report.rchit", "main", "correct(); found.t += 1.0;"),
    "reportIntersectionEXT accepts": Bug("passes/conformance/report.rint", "main",
                                         "correct(); reported.at[gl_LaunchIDEXT.x].accepted = 7u;"),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("rule", REPORT_BUGS)
def test_wrong_reports_are_noticed(rays, patched, rule):
    assert not {rule for rule in failing(ray_pipeline_checks.measure_reports(rays)) if "keeps its" not in rule}
    with patched(REPORT_BUGS[rule], device=rays.device) as shaders:
        expect_red(ray_pipeline_checks.measure_reports(shaders), rule)


@pytest.mark.slow
def test_bulk_rays_by_pipelines_notice_bugs(rays, patched):
    """The same measurements as by ray queries, with a bug in the shaders of the pipeline."""
    assert not failing(bulk_checks.measure_many_instances(rays, 300))
    bug = Bug("passes/conformance/trace.rchit", "main", "correct(); hit.t *= 1.001; hit.instance++;")
    with patched(bug, device=rays.device) as shaders:
        expect_red(bulk_checks.measure_many_instances(shaders, 300), "custom data and index of each")
        expect_red(structure_checks.measure_indices(shaders, masked("custom_index_and_mask", 0xFF00FFFF)),
                   "custom_data keeps its 24 bits")  # fmt: skip
        expect_red(bulk_checks.measure_extreme_transforms(shaders), "from the origin: t")
