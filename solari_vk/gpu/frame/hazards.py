"""Derives barriers from hazards: which steps of a frame must wait for earlier ones, and why.

A global memory barrier comes before each step that reads what an earlier step wrote, or writes what an earlier step
read or wrote. It orders all steps before it ahead of all steps after it, so later steps compare only with steps after
the barrier.
"""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce

from solari_vk.gpu.device import raw

_COMPUTE = raw.VK_PIPELINE_STAGE_2_COMPUTE_SHADER_BIT
_ALL = raw.VK_PIPELINE_STAGE_2_ALL_COMMANDS_BIT
_DRAWING = raw.VK_PIPELINE_STAGE_2_VERTEX_SHADER_BIT | raw.VK_PIPELINE_STAGE_2_FRAGMENT_SHADER_BIT
_DEPTH_TESTS = raw.VK_PIPELINE_STAGE_2_EARLY_FRAGMENT_TESTS_BIT | raw.VK_PIPELINE_STAGE_2_LATE_FRAGMENT_TESTS_BIT


@dataclass(frozen=True)
class Masks:
    """Pipeline stages and access bits of a kind of access."""

    stages: int
    access: int

    def __or__(self, other: Masks) -> Masks:
        return Masks(self.stages | other.stages, self.access | other.access)


NOTHING = Masks(0, 0)
# Without uniform reads: the host writes uniform blocks, and each submission makes host writes visible.
SHADER_READ = Masks(_COMPUTE, raw.VK_ACCESS_2_SHADER_READ_BIT)
SHADER_WRITE = Masks(_COMPUTE, raw.VK_ACCESS_2_SHADER_WRITE_BIT)
RAY_READ = Masks(raw.VK_PIPELINE_STAGE_2_RAY_TRACING_SHADER_BIT_KHR, SHADER_READ.access)
RAY_WRITE = Masks(RAY_READ.stages, SHADER_WRITE.access)
DRAW_READ = Masks(_DRAWING, SHADER_READ.access)
DRAW_WRITE = Masks(_DRAWING, SHADER_WRITE.access)
# In addition to the read of a shader, and only where one traces: without ray queries compute shaders can't have it.
STRUCTURE_READ = Masks(0, raw.VK_ACCESS_2_ACCELERATION_STRUCTURE_READ_BIT_KHR)
# Clears and depth tests count as writes; an attachment that is written may also be read.
COLOR_WRITE = Masks(
    raw.VK_PIPELINE_STAGE_2_COLOR_ATTACHMENT_OUTPUT_BIT,
    raw.VK_ACCESS_2_COLOR_ATTACHMENT_READ_BIT | raw.VK_ACCESS_2_COLOR_ATTACHMENT_WRITE_BIT,
)
DEPTH_WRITE = Masks(
    _DEPTH_TESTS, raw.VK_ACCESS_2_DEPTH_STENCIL_ATTACHMENT_READ_BIT | raw.VK_ACCESS_2_DEPTH_STENCIL_ATTACHMENT_WRITE_BIT
)
INDIRECT_READ = Masks(raw.VK_PIPELINE_STAGE_2_DRAW_INDIRECT_BIT, raw.VK_ACCESS_2_INDIRECT_COMMAND_READ_BIT)
ANY_READ = Masks(_ALL, raw.VK_ACCESS_2_MEMORY_READ_BIT)
ANY_WRITE = Masks(_ALL, raw.VK_ACCESS_2_MEMORY_WRITE_BIT)


@dataclass(frozen=True)
class Accesses:
    """The resources that a step reads and writes, by name, with the stages and access bits."""

    name: str
    reads: Mapping[str, Masks]
    writes: Mapping[str, Masks]


@dataclass(frozen=True)
class Hazard:
    """Why a step waits for `earlier`: read after write (RAW), write after read (WAR) or write after write (WAW)."""

    resource: str
    kind: str
    earlier: str

    def __str__(self) -> str:
        return f"{self.kind} {self.resource} ({self.earlier})"


@dataclass(frozen=True)
class Barrier:
    """A global memory barrier before a step."""

    hazards: tuple[Hazard, ...]
    source: Masks
    target: Masks


def plan_barriers(steps: Sequence[Accesses], every_step: bool = False) -> list[Barrier | None]:
    """The barrier before each step, or None. `every_step`: one before every step except the first.

    Work before the first step must be ordered already.
    """
    parts = [part for step in steps for part in (step.reads, step.writes)]
    # One target for all barriers: whatever of the frame comes later is ordered, not the next step alone.
    target = reduce(operator.or_, (masks for part in parts for masks in part.values()), NOTHING)
    barriers: list[Barrier | None] = []
    pending = _Pending()
    for at, step in enumerate(steps):
        hazards = pending.hazards(step)
        if hazards or (every_step and at > 0):
            # The barrier waits for the stages of reads and writes; only writes need access bits.
            source = Masks(pending.stages or _ALL, pending.access)
            barriers.append(Barrier(tuple(hazards), source, target if target != NOTHING else ANY_READ | ANY_WRITE))
            pending = _Pending()
        else:
            barriers.append(None)
        pending.add(step)
    return barriers


# A barrier orders everything before it, so each begins a new account.
class _Pending:
    """The accesses since the previous barrier."""

    def __init__(self) -> None:
        self._readers: dict[str, str] = {}
        self._writers: dict[str, str] = {}
        self.stages = 0
        self.access = 0

    def hazards(self, step: Accesses) -> list[Hazard]:
        found = [Hazard(name, "RAW", self._writers[name]) for name in step.reads if name in self._writers]
        for name in step.writes:
            # A step that also reads has a RAW hazard already, whose barrier orders the write too.
            if name in self._writers and name not in step.reads:
                found.append(Hazard(name, "WAW", self._writers[name]))
            elif name in self._readers and name not in self._writers:
                found.append(Hazard(name, "WAR", self._readers[name]))
        return found

    def add(self, step: Accesses) -> None:
        for name, masks in step.reads.items():
            self._readers[name] = step.name
            self.stages |= masks.stages
        for name, masks in step.writes.items():
            self._writers[name] = step.name
            self.stages |= masks.stages
            self.access |= masks.access
