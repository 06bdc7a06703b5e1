"""The rules of ray pipelines fail with seeded bugs: in rays, instance records and shaders."""

from __future__ import annotations

import numpy as np
import pytest
from seeded_bugs import expect_red, failing, masked

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


FOLDER = "passes/conformance"
COMMON, TRIANGLE_HIT, TRIANGLE_ANY = (f"{FOLDER}/probe_{name}" for name in ("rays.glsl", "triangle.rchit",
                                                                           "triangle.rahit"))
BOX, BOX_HIT, BOX_ANY = (f"{FOLDER}/probe_box.{name}" for name in ("rint", "rchit", "rahit"))
BOTH = ("in closest-hit", "in any-hit")
# In the file, the text, what is put in its place, and parts of the names of the rules that must fail.
SHADER_BUGS = {
    "index for the custom index": (COMMON, "uint(gl_InstanceCustomIndexEXT)", "uint(gl_InstanceID)",
                                   *(f"gl_InstanceCustomIndexEXT {where}" for where in BOTH)),
    "custom index for the index": (COMMON, "uint(gl_InstanceID)", "uint(gl_InstanceCustomIndexEXT)",
                                   *(f"gl_InstanceID {where}" for where in BOTH)),
    "primitive for geometry": (COMMON, "uint(gl_GeometryIndexEXT)", "uint(gl_PrimitiveID)",
                               *(f"gl_GeometryIndexEXT {where}" for where in BOTH), "gl_GeometryIndexEXT and"),
    "geometry for primitive": (COMMON, "uint(gl_PrimitiveID)", "uint(gl_GeometryIndexEXT)",
                               *(f"gl_PrimitiveID {where}" for where in BOTH)),
    "matrices swapped": (COMMON, "gl_ObjectToWorldEXT, gl_WorldToObjectEXT", "gl_WorldToObjectEXT, gl_ObjectToWorldEXT",
                         *(f"{matrix} {where}" for matrix in ("gl_ObjectToWorldEXT", "gl_WorldToObjectEXT")
                           for where in BOTH)),
    "world ray for the object's": (COMMON, "gl_ObjectRayOriginEXT, gl_ObjectRayDirectionEXT",
                                   "gl_WorldRayOriginEXT, gl_WorldRayDirectionEXT",
                                   *(f"gl_ObjectRayDirectionEXT {where}" for where in BOTH)),
    "the ray mistold": (COMMON, "gl_IncomingRayFlagsEXT", "0u", "tell the traced ray"),
    "front for back": (TRIANGLE_HIT, "EXT ? 1u : 0u", "EXT ? 0u : 1u", "FrontFacingTriangleEXT in closest-hit",
                       "gl_HitKindEXT: the face"),
    "front for back, any hit": (TRIANGLE_ANY, "EXT ? 1u : 0u", "EXT ? 0u : 1u", "FrontFacingTriangleEXT in any-hit"),
    "barycentrics swapped": (TRIANGLE_HIT, "gl_HitTEXT, barycentrics,", "gl_HitTEXT, barycentrics.yx,",
                             "hitAttributeEXT of triangles in closest-hit"),
    "barycentrics swapped, any hit": (TRIANGLE_ANY, "gl_HitTEXT, barycentrics,", "gl_HitTEXT, barycentrics.yx,",
                                      "hitAttributeEXT of triangles in any-hit"),
    "t a little off": (TRIANGLE_HIT, "gl_HitTEXT", "gl_HitTEXT * 1.00001", "gl_HitTEXT in closest-hit"),
    "t a little off, any hit": (TRIANGLE_ANY, "gl_HitTEXT", "gl_HitTEXT * 1.00001", "gl_HitTEXT in any-hit"),
    "another kind": (BOX, "(t, REPORTED_KIND)", "(t, REPORTED_KIND + 1u)", "gl_HitKindEXT: the face"),
    "payload lost": (BOX_HIT, "ended = ENDED_AT_HIT;", "", "whose payload the ray generation shader gets"),
    "two misses": (f"{FOLDER}/probe.rmiss", "misses, 1u", "misses, 2u", "one closest-hit or one miss shader"),
    "any-hit shaders twice": (BOX_ANY, "box_any_hits, 1u", "box_any_hits, 2u", "reported hits of AABBs unless"),
    "no intersection shader": (BOX, "RAY_ANSWER.candidate = FOUND(RAY_QUERY_INTERSECTION_AABB",
                               "RAY_ANSWER.candidate = FOUND(0u", "intersection shaders run for each AABB"),
}  # fmt: skip


@pytest.mark.parametrize("name", SHADER_BUGS)
def test_bug_in_a_shader_is_noticed(patched, ray_device, name):
    file, old, new, *rules = SHADER_BUGS[name]
    with patched((file, old, new), device=ray_device) as shaders:
        expect_red(probe(shaders), *rules)


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


@pytest.mark.parametrize(("file", "old", "new"), [
    ("rgen", "count, 1u", "count, 2u"), ("rgen", "Told(gl_LaunchIDEXT,", "Told(gl_LaunchIDEXT.yxz,"),
    ("rmiss", "gl_LaunchSizeEXT)", "gl_LaunchSizeEXT.yxz)"),
])  # fmt: skip
def test_wrong_launches_are_noticed(rays, patched, file, old, new):
    assert not failing(ray_pipeline_checks.measure_launches(rays))
    with patched((f"{FOLDER}/launch.{file}", old, new), device=rays.device) as shaders:
        expect_red(ray_pipeline_checks.measure_launches(shaders), "gl_LaunchIDEXT", "TraceRaysIndirect")


REPORT_BUGS = {
    "attributes": ("rchit", "found.attributes = attributes;", "found.attributes = attributes.yxzw;",
                   "get the attributes", "keeps its attributes"),
    "any-hit shader's attributes": ("rahit", "if (attributes ==", "if (attributes.yxzw ==", "get the attributes"),
    "farther": ("rchit", "found.t = gl_HitTEXT;", "found.t = gl_HitTEXT + 1.0;", "nearest accepted one is hit"),
    "all accepted": ("rint", "if (reportIntersectionEXT(ray.t[i], ray.kind[i])) {",
                     "reportIntersectionEXT(ray.t[i], ray.kind[i]); {", "reportIntersectionEXT accepts"),
}  # fmt: skip


@pytest.mark.parametrize("name", REPORT_BUGS)
def test_wrong_reports_are_noticed(rays, patched, name):
    file, old, new, *rules = REPORT_BUGS[name]
    assert not {rule for rule in failing(ray_pipeline_checks.measure_reports(rays)) if "keeps its" not in rule}
    with patched((f"{FOLDER}/report.{file}", old, new), device=rays.device) as shaders:
        expect_red(ray_pipeline_checks.measure_reports(shaders), *rules)


def test_bulk_rays_by_pipelines_notice_bugs(rays, patched):
    """The same measurements as by ray queries, with bugs in the shaders of the pipeline."""
    assert not failing(bulk_checks.measure_many_instances(rays, 300))
    bugs = [
        (f"{FOLDER}/trace.rchit", "gl_HitTEXT,", "gl_HitTEXT * 1.001,"),
        (f"{FOLDER}/trace.rchit", "uint(gl_InstanceID)", "uint(gl_InstanceID) + 1u"),
        (f"{FOLDER}/trace.rgen", "ray.cull_mask,", "0xFFu,"),
    ]
    with patched(*bugs, device=rays.device) as shaders:
        expect_red(bulk_checks.measure_many_instances(shaders, 300), "custom data and index of each")
        expect_red(structure_checks.measure_indices(shaders, masked("custom_index_and_mask", 0xFF00FFFF)),
                   "custom_data keeps its 24 bits")  # fmt: skip
        expect_red(bulk_checks.measure_extreme_transforms(shaders), "from the origin: t")
