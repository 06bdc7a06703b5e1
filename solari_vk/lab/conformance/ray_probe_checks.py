"""The table of probes asked of ray pipelines: what hit, miss and intersection shaders see and do."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from solari_vk.gpu.frame.frame import HitGroup, RayPass
from solari_vk.gpu.frame.ray_query_constants import RayFlags
from solari_vk.lab.conformance.outcomes import VULKAN, Measurement, Rule, count_wrong
from solari_vk.lab.conformance.probe_actions import TERMINATE
from solari_vk.lab.conformance.probe_checks import Checked, labels, measure_getters, measure_tables, probe_rays
from solari_vk.lab.conformance.probe_table import PROBES
from solari_vk.lab.conformance.probes import GENERATED, TRIANGLE, Expected, Probe
from solari_vk.lab.shader_runner import ShaderRunner
from solari_vk.lab.structures import Structures

GLSL = "GLSL_EXT_ray_tracing"
CULLING = "rayTraversalPrimitiveCulling"
"""The feature that the flags for triangles and AABBs need."""
# What the payload says of the shader that ended the ray, as probe_rays.glsl writes it.
_ENDED_NOWHERE = 1
_ENDED_AT_HIT = 2
_ENDED_AT_MISS = 3
_KINDS = {int(TRIANGLE): (0xFF, 0xFE), int(GENERATED): (77, 77)}  # gl_HitKindEXT of back and front faces
_FOLDER = "passes/conformance/probe"
_HITS = [
    HitGroup(f"{_FOLDER}_triangle.rchit", f"{_FOLDER}_triangle.rahit"),
    HitGroup(f"{_FOLDER}_box.rchit", f"{_FOLDER}_box.rahit", f"{_FOLDER}_box.rint"),
]

# What the rules of ray queries are for ray pipelines.
_CULLING = "Ray Intersection Culling"
_CONFIRMATION = "Ray Intersection Confirmation"
_CLOSEST = "Ray Closest Hit Determination"
_RESULT = "Ray Result Determination"
_CANDIDATES = "Ray Traversal"
_BUILT_INS = "Built-In Variables"
_COUNTERPARTS = {
    "no flag": (
        _CONFIRMATION,
        "gl_RayFlagsNoneEXT: any-hit shaders run for triangles that aren't opaque, and for no others",
    ),
    "FORCE_OPAQUE": (_CONFIRMATION, "gl_RayFlagsOpaqueEXT: all triangles are hit, and no any-hit shader runs"),
    "FORCE_NO_OPAQUE": (_CONFIRMATION, "gl_RayFlagsNoOpaqueEXT: any-hit shaders run for all triangles"),
    "TERMINATE_ON_FIRST_HIT": (_CLOSEST, "gl_RayFlagsTerminateOnFirstHitEXT: the first accepted hit ends the search"),
    "SKIP_CLOSEST_HIT_SHADER": (
        _RESULT,
        "gl_RayFlagsSkipClosestHitShaderEXT: neither a closest-hit nor a miss shader runs after a hit",
    ),
    "CULL_BACK_FACING": (_CULLING, "gl_RayFlagsCullBackFacingTrianglesEXT: back faces are not hit"),
    "CULL_FRONT_FACING": (_CULLING, "gl_RayFlagsCullFrontFacingTrianglesEXT: front faces are not hit"),
    "CULL_OPAQUE": (_CULLING, "gl_RayFlagsCullOpaqueEXT: opaque geometry is not hit"),
    "CULL_NO_OPAQUE": (_CULLING, "gl_RayFlagsCullNoOpaqueEXT: geometry that isn't opaque is not hit"),
    "SKIP_TRIANGLES": (_CULLING, "gl_RayFlagsSkipTrianglesEXT: triangles are not hit"),
    "SKIP_AABBS": (_CULLING, "gl_RayFlagsSkipAABBEXT: no intersection shader runs"),
    "RayDesc.cull_mask": (_CULLING, "cullMask of traceRayEXT: hit when it shares a bit with the instance's mask"),
    "RayDesc.t_min": (_CANDIDATES, "Tmin of traceRayEXT: only points beyond it"),
    "RayDesc.t_max": (_CANDIDATES, "Tmax of traceRayEXT: only points before it"),
    "RayDesc.dir": (_CANDIDATES, "direction of traceRayEXT: t is in units of its length"),
    "RayIntersection.instance_index, instance_custom_data, sbt_record_offset": (
        _BUILT_INS,
        "gl_InstanceID and gl_InstanceCustomIndexEXT of instances with all bits",
    ),
    "RayIntersection.geometry_index, primitive_index": (
        _BUILT_INS,
        "gl_GeometryIndexEXT and gl_PrimitiveID of several geometries",
    ),
    "RayIntersection.object_to_world, world_to_object of moved, rotated, mirrored and sheared instances": (
        _BUILT_INS,
        "gl_ObjectToWorldEXT and gl_WorldToObjectEXT of moved, rotated, mirrored and sheared instances",
    ),
    "rayQueryGenerateIntersection commits a hit that is the nearest so far": (
        _CLOSEST,
        "reportIntersectionEXT: the nearest hit that it accepts is the closest hit",
    ),
    "rayQueryProceed stops at each AABB, opaque or not": (
        _CONFIRMATION,
        "intersection shaders run for each AABB, opaque or not",
    ),
    "rayQueryConfirmIntersection commits the candidate triangle": (
        _CONFIRMATION,
        "ignoreIntersectionEXT lets the ray through; triangles that no any-hit shader ignores are hit",
    ),
    "rayQueryTerminate ends the search and keeps what is committed": (
        _CLOSEST,
        "terminateRayEXT accepts the hit and ends the search",
    ),
}
_MEMBERS = {
    "instance_custom_data": "gl_InstanceCustomIndexEXT",
    "instance_index": "gl_InstanceID",
    "geometry_index": "gl_GeometryIndexEXT",
    "primitive_index": "gl_PrimitiveID",
    "front_face": "gl_HitKindFrontFacingTriangleEXT",
    "t": "gl_HitTEXT",
    "barycentrics": "hitAttributeEXT of triangles",
    "object_to_world": "gl_ObjectToWorldEXT",
    "world_to_object": "gl_WorldToObjectEXT",
    "object_ray": "gl_ObjectRayOriginEXT, gl_ObjectRayDirectionEXT",
}
_STAGES = {"committed": "closest-hit shaders", "candidate": "any-hit and intersection shaders"}
_ENDS = Rule(
    "traceRayEXT runs one closest-hit or one miss shader, whose payload the ray generation shader gets", VULKAN, _RESULT
)
_KIND = Rule(
    "gl_HitKindEXT: the face of a triangle, or the kind that reportIntersectionEXT was given", GLSL, _BUILT_INS
)
_RAY = Rule(
    "gl_RayTminEXT, gl_IncomingRayFlagsEXT, gl_WorldRayOriginEXT, gl_WorldRayDirectionEXT tell the traced ray",
    GLSL,
    _BUILT_INS,
)
_OPAQUE_BOX = Rule("any-hit shaders run for reported hits of AABBs unless these are opaque", VULKAN, _CONFIRMATION)

# Ending a search without accepting the hit is for ray queries only.
ASKED = [probe for probe in PROBES if not probe.action & TERMINATE or probe.committed is not None]


def culls(probe: Probe) -> bool:
    """Whether the ray has a flag that needs CULLING."""
    return bool(probe.flags & (RayFlags.SKIP_TRIANGLES | RayFlags.SKIP_AABBS))


def rule_of(probe: Probe) -> Rule:
    """The counterpart of a probe's rule. The rules of instance flags are the same."""
    if probe.rule.document == VULKAN:
        return probe.rule
    section, name = _COUNTERPARTS.get(probe.rule.name) or _COUNTERPARTS[probe.rule.name.split(":")[0]]
    return Rule(name, GLSL if section == _BUILT_INS else VULKAN, section)


def _member_rule(name: str, which: str) -> Rule | None:
    return Rule(f"{_MEMBERS[name]} in {_STAGES[which]}", GLSL, _BUILT_INS) if name in _MEMBERS else None


def rules() -> list[Rule]:
    """The rules that probes prove, without those of members."""
    return list(dict.fromkeys([*map(rule_of, ASKED), _ENDS, _KIND, _RAY, _OPAQUE_BOX]))


def measure_probes(
    shaders: ShaderRunner,
    structures: Structures,
    probes: Sequence[Probe] = tuple(ASKED),
    damage: Callable[[np.ndarray], None] | None = None,
    culling: bool = True,
) -> Iterator[Measurement]:
    """Measure all rules that the probes prove. `damage` changes the rays before they are sent, to seed bugs.

    culling: whether the device has the feature CULLING, which some flags of rays need."""
    rays = probe_rays(shaders.element("conformance/probe", "probes"), probes)
    sent = rays.copy()
    if damage is not None:
        damage(sent)
    # A shader with the flags for triangles and AABBs needs the feature, even where no ray has them.
    name = "conformance/probe_culling" if culling else "conformance/probe"
    step = RayPass(name, threads=len(rays), misses=[f"{_FOLDER}.rmiss"], hits=_HITS)
    # Rays that run no shader at all must be told from those that do: zeros are "not run".
    before = np.zeros(len(rays), shaders.element("conformance/probe.rgen", "ray_answers"))
    inputs = {"tlas": structures.tlas, "probes": sent}
    answers = shaders.run_steps([step], inputs, {"ray_answers": before})["ray_answers"]
    checked = [_Traced(*item) for item in zip(probes, rays, answers, strict=True)]
    yield from measure_tables(checked, rule_of)
    yield count_wrong(_ENDS, labels(checked, lambda item: not item.ends_once()))
    for which in _STAGES:
        yield from measure_getters(checked, which, _member_rule)
    yield count_wrong(_RAY, labels(checked, lambda item: item.shaded and not item.tells_its_ray()))
    # A rule that no ray is a case of has no row, rather than one that holds.
    hits = [item for item in checked if item.answer["committed"]["kind"]]
    if hits:
        yield count_wrong(_KIND, labels(hits, lambda item: not item.tells_its_kind()))
    boxes = [item for item in checked if item.answer["accepted"]]
    if boxes:
        yield count_wrong(_OPAQUE_BOX, labels(boxes, lambda item: not item.runs_any_hits()))


class _Traced(Checked):
    """A probe that was traced by a ray pipeline. Hit shaders aren't told the record offset of an instance."""

    @property
    def _skips(self) -> bool:
        return bool(self.probe.flags & RayFlags.SKIP_CLOSEST_HIT_SHADER)

    @property
    def shaded(self) -> bool:
        """Whether a closest-hit or a miss shader had to run."""
        return self.probe.committed is None or not self._skips

    def expected(self, which: str) -> Expected | None:
        """As in the table, except that nobody sees the closest hit if its shader is skipped."""
        return None if which == "committed" and self._skips else super().expected(which)

    def wrong(self) -> str:
        """What is wrong, in words; empty when nothing is."""
        if self.answer["ended"] == 0:
            return "not run"
        payload = "" if self.answer["ended"] == self._expected_end() else f"payload {self.answer['ended']}"
        return super().wrong() or payload

    def _expected_end(self) -> int:
        if not self.shaded:
            return _ENDED_NOWHERE
        return _ENDED_AT_HIT if self.probe.committed else _ENDED_AT_MISS

    def discrete(self, which: str) -> list[str]:
        """The names of integer members that are wrong, without the record offset."""
        return [name for name in super().discrete(which) if name in _MEMBERS]

    def ends_once(self) -> bool:
        """Whether one closest-hit or miss shader ran, and the ray generation shader has its payload."""
        counts = (int(self.answer["closest_hits"]), int(self.answer["misses"]))
        # Any other counts are wrong: a second shader, or the same one twice.
        ran = {(0, 0): _ENDED_NOWHERE, (1, 0): _ENDED_AT_HIT, (0, 1): _ENDED_AT_MISS}.get(counts)
        return bool(ran == self.answer["ended"])

    def tells_its_kind(self) -> bool:
        """Whether gl_HitKindEXT is that of the hit."""
        hit = self.answer["committed"]
        return bool(self.answer["hit_kind"] == _KINDS[int(hit["kind"])][int(hit["front_face"])])

    def runs_any_hits(self) -> bool:
        """Whether the any-hit shader ran for each reported hit, or for none if the box is opaque."""
        opaque = self.placed.shape == "opaque boxes" or self.probe.flags & RayFlags.FORCE_OPAQUE
        return int(self.answer["box_any_hits"]) == (0 if opaque else int(self.answer["accepted"]))
