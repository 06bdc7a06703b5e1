"""The labelled probes can fail: each flag, field and getter has a seeded bug."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from seeded_bugs import expect_red, failing, masked

from solari_vk.conformance import probe_actions, probe_checks
from solari_vk.conformance import probes as told
from solari_vk.conformance.probe_table import PROBES
from solari_vk.conformance.probes import INSTANCES, SHAPES
from solari_vk.conformance.worlds import World


def probe(shaders, *, rays=None, records=None, shapes=SHAPES):
    """All measurements of the probes with damaged rays, instance records or shapes."""
    with World(shaders.device, shapes, list(INSTANCES.values()), damage=records) as world:
        return list(probe_checks.measure(*probe_checks.run_probes(shaders, world, damage=rays)))


def test_there_are_enough_probes_and_they_pass(shaders):
    assert len(PROBES) >= 40
    assert len({item.label for item in PROBES}) == len(PROBES)
    assert not failing(probe(shaders))


def without_flag(flag):
    def damage(rays):
        rays["flags"] &= ~np.uint32(flag)

    return damage


FLAGS = ["FORCE_OPAQUE", "FORCE_NO_OPAQUE", "TERMINATE_ON_FIRST_HIT", "CULL_BACK_FACING", "CULL_FRONT_FACING",
         "CULL_OPAQUE", "CULL_NO_OPAQUE", "SKIP_TRIANGLES", "SKIP_AABBS"]  # fmt: skip


@pytest.mark.parametrize("name", FLAGS)
def test_ignored_flag_is_noticed(shaders, name):
    expect_red(probe(shaders, rays=without_flag(getattr(told, name))), name)


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
    "direction normalized": (normalized, ["dir: t counts", "RayIntersection.t, committed"]),
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
    records[:] = np.roll(records, 1)


def all_active(records):
    records["blas_address"][records["blas_address"] == 0] = records["blas_address"][0]


RECORD_BUGS = {
    "mask dropped": (lambda r: np.bitwise_or(r["custom_index_and_mask"], 0xFF000000, out=r["custom_index_and_mask"]),
                     ["cull_mask"]),
    "custom data of 23 bits": (masked("custom_index_and_mask", 0xFF7FFFFF), ["instance_custom_data, committed"]),
    "no record offset": (masked("sbt_offset_and_flags", 0xFF000000), ["sbt_record_offset, committed"]),
    "no instance flags": (
        masked("sbt_offset_and_flags", 0xFFFFFF),
        ["FLIP_FACING", "FACING_CULL_DISABLE", "FORCE_OPAQUE and FORCE_NO_OPAQUE of instances"],
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
    """Opacity swapped, geometries and primitives in another order."""
    swapped = {name: [replace(part, opaque=not part.opaque) for part in parts] for name, parts in SHAPES.items()}
    expect_red(probe(shaders, shapes=swapped), "no flag", "CULL_OPAQUE", "CandidateAABBOpaque")
    reordered = SHAPES | {"many": SHAPES["many"][::-1], "two lists of boxes": SHAPES["two lists of boxes"][::-1]}
    expect_red(probe(shaders, shapes=reordered), "geometry_index", "geometry_index, committed")


QUERY = "scene/ray_query.glsl"


def test_bugs_in_the_getters_are_noticed(patched):
    """Each bug is in a getter of its own, so that one shader holds them all."""
    bugs = [
        (QUERY, "rayQueryGetIntersectionInstanceCustomIndexEXT(query, COMMITTED))",
         "rayQueryGetIntersectionInstanceIdEXT(query, COMMITTED) + 7)"),
        (QUERY, "found.instance_index = uint(rayQueryGetIntersectionInstanceIdEXT(query, COMMITTED))",
         "found.instance_index = 1u + uint(rayQueryGetIntersectionInstanceIdEXT(query, COMMITTED))"),
        (QUERY, "rayQueryGetIntersectionGeometryIndexEXT(query, COMMITTED)", "0"),
        (QUERY, "= rayQueryGetIntersectionObjectToWorldEXT(query, COMMITTED)",
         "= rayQueryGetIntersectionWorldToObjectEXT(query, COMMITTED)"),
        (QUERY, "rayQueryGetIntersectionBarycentricsEXT(query, COMMITTED)",
         "rayQueryGetIntersectionBarycentricsEXT(query, COMMITTED).yx"),
        (QUERY, "rayQueryGetIntersectionFrontFaceEXT(query, COMMITTED)",
         "!rayQueryGetIntersectionFrontFaceEXT(query, COMMITTED)"),
        ("passes/conformance/probe.glsl", "rayQueryGetIntersectionObjectRayOriginEXT(query, true)",
         "rayQueryGetWorldRayOriginEXT(query)"),
    ]  # fmt: skip
    names = ("instance_custom_data", "instance_index", "geometry_index", "object_to_world", "barycentrics",
             "front_face")  # fmt: skip
    with patched(*bugs) as shaders:
        expect_red(probe(shaders), *(f"RayIntersection.{name}, committed" for name in names), "ObjectRayOrigin")


def test_bugs_in_the_functions_are_noticed(patched):
    """Wrong kinds, the ray mistold, t of the wrong end, and an inverse that isn't one."""
    bugs = [
        (QUERY, "RAY_QUERY_INTERSECTION_GENERATED = 2u", "RAY_QUERY_INTERSECTION_GENERATED = 4u"),
        (QUERY, "RAY_QUERY_INTERSECTION_AABB = 3u", "RAY_QUERY_INTERSECTION_AABB = 2u"),
        (QUERY, "found.t = rayQueryGetIntersectionTEXT(query, COMMITTED)",
         "found.t = 1.00001 * rayQueryGetIntersectionTEXT(query, COMMITTED)"),
        (QUERY, "= rayQueryGetIntersectionWorldToObjectEXT(query, COMMITTED)",
         "= mat4x3(transpose(mat3(rayQueryGetIntersectionObjectToWorldEXT(query, COMMITTED))))"),
        (QUERY, "uint(rayQueryGetIntersectionPrimitiveIndexEXT(query, COMMITTED))",
         "uint(rayQueryGetIntersectionPrimitiveIndexEXT(query, COMMITTED) + 1)"),
        ("passes/conformance/probe.glsl", "answer.t_min = rayQueryGetRayTMinEXT(query)", "answer.t_min = probe.t_max"),
    ]  # fmt: skip
    with patched(*bugs) as shaders:
        expect_red(
            probe(shaders), "a box is a candidate", "RayIntersection.t, committed", "world_to_object, committed",
            "RayIntersection.primitive_index, committed", "OpRayQueryGetRayTMin",
        )  # fmt: skip
