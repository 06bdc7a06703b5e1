"""What a debug build of scene/ray_query.glsl counted: which rules of the document shaders broke, and where first."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from solari_vk.errors import SolariError
from solari_vk.gpu.frame.frame import Frame

RAY_QUERY_DEBUG = "#define RAY_QUERY_DEBUG"
"""The header of a pass whose ray queries are checked; its stage declares FAULT_BUFFERS too."""

# The rows of ray_query_faults, FAULT_* of scene/ray_query_debug.glsl.
RULES = (
    "an intersection was asked for before rayQueryProceed",
    "rayQueryGetCommittedIntersection while rayQueryProceed stands at a candidate",
    "rayQueryGetCandidateIntersection while rayQueryProceed stands at no candidate",
    "getCommittedHitVertexPositions while rayQueryProceed stands at a candidate",
    "getCandidateHitVertexPositions while rayQueryProceed stands at no candidate",
    "the vertices of what is no triangle",
    "rayQueryProceed before rayQueryInitialize",
    "rayQueryGenerateIntersection for what is no AABB",
    "rayQueryGenerateIntersection outside of t_min .. t_max",
    "rayQueryGenerateIntersection while rayQueryProceed stands at no candidate",
    "rayQueryConfirmIntersection for what is no triangle",
    "rayQueryConfirmIntersection while rayQueryProceed stands at no candidate",
    "rayQueryTerminate before rayQueryInitialize",
    "a ray with NaN, an infinite origin, direction or t_min, no direction, or t_min outside of 0 .. t_max",
    "flags that contradict each other",
)
FAULT_BUFFERS: Mapping[str, int] = {"ray_query_faults": len(RULES)}


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
