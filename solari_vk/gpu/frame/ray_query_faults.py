"""What a debug build of scene/ray_query.glsl counted: which rules of the document shaders broke, and where first."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from solari_vk.errors import SolariError
from solari_vk.gpu.shaders.headers import enumeration

if TYPE_CHECKING:
    from solari_vk.gpu.frame.frame import Frame

RAY_QUERY_DEBUG = "#define RAY_QUERY_DEBUG"
"""The header of a pass whose ray queries are checked; its stage declares FAULT_BUFFERS too."""

_RULES = {
    "get_before_proceed": "an intersection was asked for before rayQueryProceed",
    "committed_while_candidate": "rayQueryGetCommittedIntersection while rayQueryProceed stands at a candidate",
    "candidate_while_committed": "rayQueryGetCandidateIntersection while rayQueryProceed stands at no candidate",
    "committed_positions_while_candidate": (
        "getCommittedHitVertexPositions while rayQueryProceed stands at a candidate"
    ),
    "candidate_positions_while_committed": (
        "getCandidateHitVertexPositions while rayQueryProceed stands at no candidate"
    ),
    "positions_of_no_triangle": "the vertices of what is no triangle",
    "proceed_before_initialize": "rayQueryProceed before rayQueryInitialize",
    "generate_of_no_aabb": "rayQueryGenerateIntersection for what is no AABB",
    "generate_out_of_range": "rayQueryGenerateIntersection outside of t_min .. t_max",
    "generate_without_candidate": "rayQueryGenerateIntersection while rayQueryProceed stands at no candidate",
    "confirm_of_no_triangle": "rayQueryConfirmIntersection for what is no triangle",
    "confirm_without_candidate": "rayQueryConfirmIntersection while rayQueryProceed stands at no candidate",
    "terminate_before_initialize": "rayQueryTerminate before rayQueryInitialize",
    "invalid_ray": (
        "a ray with NaN, an infinite origin, direction or t_min, no direction, or t_min outside of 0 .. t_max"
    ),
    "contradicting_flags": "flags that contradict each other",
}
RULES = tuple(_RULES.values())
"""What each row of `ray_query_faults` counts."""
FAULT_BUFFERS: Mapping[str, int] = {"ray_query_faults": len(RULES)}


def glsl_header() -> str:
    """FAULT_GET_BEFORE_PROCEED and so on: the rows of `ray_query_faults`."""
    return enumeration("FAULT", _RULES)


@dataclass(frozen=True)
class RayQueryFault:
    """A broken rule: how often, and the invocation that broke it first."""

    rule: str
    count: int
    invocation: tuple[int, ...]

    def __str__(self) -> str:
        return f"{self.rule} ({self.count:,} times, first in invocation {self.invocation})"


def ray_query_faults(frame: Frame) -> list[RayQueryFault]:
    """What the frame's passes with RAY_QUERY_DEBUG have counted so far; waits for them."""
    rows: np.ndarray[Any, Any] = frame["ray_query_faults"]
    return [
        RayQueryFault(rule, int(row["count"]), tuple(row["invocation"].tolist()))
        for rule, row in zip(RULES, rows, strict=True)
        if row["count"]
    ]


def check_ray_queries(frame: Frame) -> None:
    """Raise SolariError when a shader has broken a rule, naming each."""
    if faults := ray_query_faults(frame):
        raise SolariError("ray queries: " + "; ".join(map(str, faults)))
