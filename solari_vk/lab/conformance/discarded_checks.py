"""Calls and rays that the wgpu document discards, and rays that hit and miss shaders trace."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from solari_vk.gpu.frame.ray_query_constants import RayFlags
from solari_vk.gpu.frame.stages import HitGroup, RayPass
from solari_vk.lab.conformance.outcomes import WGPU, Measurement, Rule, count_wrong
from solari_vk.lab.shader_runner import ShaderRunner
from solari_vk.lab.structures import Boxes, Placement, Shapes, Structures, Triangles

_SECTION = "Ray Queries"
_PROCEED = Rule("rayQueryProceed before initializing, and after it returned false, is discarded", WGPU, _SECTION)
_GET = Rule("getters at another time than theirs give zeros", WGPU, _SECTION)
_GENERATE = Rule("rayQueryGenerateIntersection without a candidate or out of range is discarded", WGPU, _SECTION)
_CONFIRM = Rule("rayQueryConfirmIntersection without a candidate is discarded", WGPU, _SECTION)
_TERMINATE = Rule("rayQueryTerminate before initializing, and after the end, is discarded", WGPU, _SECTION)
_AFTER_TERMINATE = Rule("after rayQueryTerminate the next rayQueryProceed returns false", WGPU, _SECTION)
_FLAGS = Rule("a ray with contradicting flags is discarded", WGPU, _SECTION)
# The cases of glsl/passes/conformance/discarded.comp, in their order.
_CASES = (
    ("a plain ray", _PROCEED),
    ("proceed before initializing", _PROCEED),
    ("committed before initializing", _GET),
    ("candidate before initializing", _GET),
    ("committed before proceeding", _GET),
    ("candidate before proceeding", _GET),
    ("committed at a candidate", _GET),
    ("candidate after the end", _GET),
    ("proceed after the end", _PROCEED),
    ("generate before initializing", _GENERATE),
    ("generate after the end", _GENERATE),
    ("generate before t_min", _GENERATE),
    ("generate beyond t_max", _GENERATE),
    ("generate behind the committed hit", _GENERATE),
    ("confirm before initializing", _CONFIRM),
    ("confirm after the end", _CONFIRM),
    ("terminate before initializing", _TERMINATE),
    ("terminate after the end", _TERMINATE),
    ("terminate at a candidate", _AFTER_TERMINATE),
    ("opaque and not opaque", _FLAGS),
    ("both faces culled", _FLAGS),
    ("neither triangles nor boxes", _FLAGS),
)
DISCARDED_RULES = tuple(dict.fromkeys(rule for _, rule in _CASES))

_NESTED = Rule("closest-hit and miss shaders may trace rays", WGPU, "Ray Tracing Pipelines")
_INVALID = Rule("traceRay of an invalid ray leaves the payload as it was", WGPU, "Ray Tracing Pipelines")
NESTED_RULES = (_NESTED, _INVALID)
_TRIANGLE = np.array([[(0, 0, 0), (2, 0, 0), (0, 2, 0)]], np.float64)
_GLASS = np.concatenate([_TRIANGLE, _TRIANGLE - np.array((0, 0, 1))]) + np.array((2, 0, 0))  # one below the other
_DOWN = (0, 0.0, 9.0, (0.6, 0.3, 5.0), (0.0, 0.0, -1.0))


def measure_discarded(shaders: ShaderRunner) -> Iterator[Measurement]:
    """Make each call at a time at which it is discarded."""
    shapes: Shapes = {
        "opaque": [Triangles(_TRIANGLE)],
        "glass": [Triangles(_GLASS, opaque=False)],
        "box": [Boxes(np.array([[(6, 0, 0), (7, 1, 1)]], np.float64))],
    }
    with Structures(shaders.device, shapes, [Placement(name) for name in shapes]) as structures:
        outputs = {"left": len(_CASES)}
        left = shaders.run("conformance/discarded", len(_CASES), {"tlas": structures.tlas}, outputs)["left"]
    for rule in DISCARDED_RULES:
        yield count_wrong(rule, [name for (name, of), wrong in zip(_CASES, left, strict=True) if of is rule and wrong])


def measure_nested(shaders: ShaderRunner) -> Iterator[Measurement]:
    """Trace rays whose hit and miss shaders trace others, and rays that are invalid."""
    flags, t_min, t_max, origin, down = _DOWN
    cases = {
        "onto the triangle": (_DOWN, (1, 10)),
        "beside it": ((flags, t_min, t_max, (5.0, 5.0, 5.0), down), (10, 1)),
        "origin of NaN": ((flags, t_min, t_max, (np.nan, 0.3, 5.0), down), (0, 0)),
        "no direction": ((flags, t_min, t_max, origin, (0.0, 0.0, 0.0)), (0, 0)),
        "t_max < t_min": ((flags, 9.0, 1.0, origin, down), (0, 0)),
        "flags": ((RayFlags.FORCE_OPAQUE | RayFlags.FORCE_NO_OPAQUE, t_min, t_max, origin, down), (0, 0)),
    }
    rays = np.array([ray for ray, _ in cases.values()], shaders.element("conformance/nested.rgen", "nested_rays"))
    folder = "passes/conformance/nested"
    hits = [HitGroup(f"{folder}.rchit")]
    step = RayPass("conformance/nested", len(rays), misses=[f"{folder}.rmiss"], hits=hits, max_recursion_depth=2)
    with Structures(shaders.device, {"triangle": [Triangles(_TRIANGLE)]}, [Placement("triangle")]) as structures:
        inputs = {"tlas": structures.tlas, "nested_rays": rays}
        found = shaders.run_steps([step], inputs, {"nested_found": len(rays)})["nested_found"]
    wrong = {
        name: not np.array_equal((got["hits"], got["misses"]), wanted)
        for (name, (_, wanted)), got in zip(cases.items(), found, strict=True)
    }
    for rule, names in ((_NESTED, list(cases)[:2]), (_INVALID, list(cases)[2:])):
        yield count_wrong(rule, [name for name in names if wrong[name]])
