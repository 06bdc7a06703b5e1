"""Reads what a debug build of scene/ray_query.glsl counts: the rules of the wgpu document that shaders broke."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from solari_vk.base.errors import SolariError
from solari_vk.gpu.shaders.headers import enumeration

if TYPE_CHECKING:
    from solari_vk.gpu.frame.frame import Frame

RAY_QUERY_DEBUG = "#define RAY_QUERY_DEBUG"
"""The header of a pass whose ray queries are checked. Its stage must declare FAULT_BUFFERS as well."""

# The keys become constants of the shaders by `glsl_header`; the order of rows is that of the buffer.
FAULTS = {
    "get_before_proceed": "an intersection was read before the first rayQueryProceed",
    "committed_while_candidate": "rayQueryGetCommittedIntersection while there is a candidate",
    "candidate_while_committed": "rayQueryGetCandidateIntersection without a candidate",
    "committed_positions_while_candidate": "getCommittedHitVertexPositions while there is a candidate",
    "candidate_positions_while_committed": "getCandidateHitVertexPositions without a candidate",
    "positions_of_no_triangle": "vertex positions of an intersection that is no triangle",
    "proceed_before_initialize": "rayQueryProceed before rayQueryInitialize",
    "generate_of_no_aabb": "rayQueryGenerateIntersection for a candidate that is no AABB",
    "generate_out_of_range": "rayQueryGenerateIntersection outside t_min .. t_max",
    "generate_without_candidate": "rayQueryGenerateIntersection without a candidate",
    "confirm_of_no_triangle": "rayQueryConfirmIntersection for a candidate that is no triangle",
    "confirm_without_candidate": "rayQueryConfirmIntersection without a candidate",
    "terminate_before_initialize": "rayQueryTerminate before rayQueryInitialize",
    "invalid_ray": (
        "a ray with NaN, an infinite origin, direction or t_min, a zero direction, or t_min outside 0 .. t_max"
    ),
    "contradicting_flags": "contradictory ray flags",
}
RULES = tuple(FAULTS.values())
"""The rule that each row of the buffer `ray_query_faults` counts."""
FAULT_BUFFERS: Mapping[str, int] = {"ray_query_faults": len(RULES)}


def glsl_header() -> str:
    """FAULT_GET_BEFORE_PROCEED and so on: the rows of `ray_query_faults`."""
    return enumeration("FAULT", FAULTS)


@dataclass(frozen=True)
class RayQueryFault:
    """A broken rule: how often it was broken, and the first invocation that broke it."""

    rule: str
    count: int
    invocation: tuple[int, ...]

    def __str__(self) -> str:
        return f"{self.rule} ({self.count:,} times, first in invocation {self.invocation})"


def ray_query_faults(frame: Frame) -> list[RayQueryFault]:
    """The faults that the frame's passes with RAY_QUERY_DEBUG have counted so far; waits for the latest frame."""
    rows: np.ndarray[Any, Any] = frame["ray_query_faults"]
    return [
        RayQueryFault(rule, int(row["count"]), tuple(row["invocation"].tolist()))
        for rule, row in zip(RULES, rows, strict=True)
        if row["count"]
    ]


def check_ray_queries(frame: Frame) -> None:
    """Raise SolariError naming every rule that a shader has broken."""
    faults = ray_query_faults(frame)
    if faults:
        raise SolariError("ray queries: " + "; ".join(map(str, faults)))
