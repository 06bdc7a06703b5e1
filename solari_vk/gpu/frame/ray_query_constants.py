"""The wgpu document's numbers for ray queries, which shaders get by `generated/gpu/frame/ray_query_constants.glsl`."""

from __future__ import annotations

from enum import IntEnum, IntFlag

from solari_vk.gpu.shaders.headers import constants


class RayFlags(IntFlag):
    """RayDesc.flags, from the document's "Flags for RayDesc::flags"."""

    FORCE_OPAQUE = 0x1
    FORCE_NO_OPAQUE = 0x2
    TERMINATE_ON_FIRST_HIT = 0x4
    SKIP_CLOSEST_HIT_SHADER = 0x8
    CULL_BACK_FACING = 0x10
    CULL_FRONT_FACING = 0x20
    CULL_OPAQUE = 0x40
    CULL_NO_OPAQUE = 0x80
    SKIP_TRIANGLES = 0x100
    SKIP_AABBS = 0x200


class IntersectionKind(IntEnum):
    """RayIntersection.kind, from the document's "Constants for RayIntersection::kind"."""

    NONE = 0
    TRIANGLE = 1
    GENERATED = 2
    AABB = 3


def glsl_header() -> str:
    """Both as GLSL constants: RAY_FLAG_NONE, the flags by their names, RAY_QUERY_INTERSECTION_*."""
    kinds = {f"RAY_QUERY_INTERSECTION_{kind.name}": int(kind) for kind in IntersectionKind}
    return constants(RAY_FLAG_NONE=0, **{str(flag.name): int(flag) for flag in RayFlags}, **kinds)
