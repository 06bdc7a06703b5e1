"""What a probe is, and the scene of all probes: a probe is a ray with what the documents say that it must find.

Each probe is described in the object space of one instance, where its result is easy to see. Instances lie 10 apart
in x, so that a ray meets its own instance only.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from solari_vk.gpu.frame.ray_query_constants import IntersectionKind
from solari_vk.lab.conformance.outcomes import VULKAN, WGPU, Rule
from solari_vk.lab.conformance.probe_actions import CONFIRM
from solari_vk.lab.structures import (
    CULL_DISABLE,
    FLIP_FACING,
    INSTANCE_NO_OPAQUE,
    INSTANCE_OPAQUE,
    Boxes,
    Placement,
    Triangles,
)

NONE, TRIANGLE, GENERATED, AABB = IntersectionKind


def triangle(x: float = 0.0, z: float = 0.0) -> NDArray[np.float64]:
    """The triangle (x, 0, z), (x + 2, 0, z), (x, 2, z), which faces +z, as an array (3, 3)."""
    return np.array([(x, 0, z), (x + 2, 0, z), (x, 2, z)], np.float64)


def _stack(first: float = 0.0) -> NDArray[np.float64]:
    return np.stack([triangle(0, first - i) for i in range(4)])


_UNIT_BOXES = np.array([[(2 * i, 0, 0), (2 * i + 1, 1, 1)] for i in range(3)], np.float64)
# Transforms of geometries: the one mirrors, the other moves.
_MIRROR = np.array([(-1, 0, 0, 2), (0, 1, 0, 0), (0, 0, 1, 0)], np.float64)
_MOVE = np.array([(1, 0, 0, 4), (0, 1, 0, 0), (0, 0, 1, 0.5)], np.float64)

SHAPES: dict[str, tuple[Triangles | Boxes, ...]] = {
    "opaque": (Triangles(triangle()[None]),),
    "glass": (Triangles(triangle()[None], opaque=False),),
    "wall": (Triangles(_stack()),),
    "glass stack": (Triangles(_stack(), opaque=False),),
    "glass over opaque": (Triangles(triangle(0, -1)[None]), Triangles(triangle()[None], opaque=False)),
    "many": (
        Triangles(triangle()[None]),
        Triangles(np.stack([triangle(2), triangle(2, -1)]), index_dtype=np.uint16, stride=28),
        Triangles(np.stack([triangle(0, -i) for i in range(3)]), index_dtype=np.uint32, transform=_MOVE),
    ),
    "mirrored geometry": (Triangles(triangle()[None], transform=_MIRROR),),
    "boxes": (Boxes(_UNIT_BOXES),),
    "opaque boxes": (Boxes(_UNIT_BOXES, opaque=True, stride=32),),
    "two lists of boxes": (Boxes(_UNIT_BOXES[:1]), Boxes(_UNIT_BOXES[:2] + np.array((0, 2, 0)), stride=40)),
}

_TURN = np.array([(0.6, 0, 0.8), (0, 1, 0), (-0.8, 0, 0.6)])
# Columns of different lengths that are not orthogonal: neither transpose nor column lengths invert it.
_SHEAR = np.array([(2.0, 0.5, 0.0), (0.0, 0.75, -0.25), (0.0, 0.0, 0.5)])


def _instances() -> dict[str, Placement]:
    """The instances by label, 10 apart."""
    linear = {
        "mirrored": np.diag((-1.0, 1, 1)),
        "turned": _TURN,
        "stretched": np.diag((3.0, 0.5, 1.25)),
        "sheared": _TURN @ _SHEAR,
        "inverted": -_TURN @ np.diag((0.5, 2.0, 1)),
        "tiny": np.eye(3) * 2.0**-10,
        "turned boxes": _TURN @ np.diag((1.0, 0.5, 2)),
        "flipped mirrored": np.diag((-1.0, 1, 1)),
    }
    told: dict[str, dict[str, object]] = {
        **{name: {"shape": name} for name in SHAPES},
        "many": {"shape": "many", "custom": 0x5A5A5A},
        "made opaque": {"shape": "glass", "flags": INSTANCE_OPAQUE},
        "made glass": {"flags": INSTANCE_NO_OPAQUE},
        "opaque stack": {"shape": "glass stack", "flags": INSTANCE_OPAQUE},
        "two-sided": {"flags": CULL_DISABLE},
        "flipped": {"flags": FLIP_FACING},
        "flipped mirrored": {"flags": FLIP_FACING},
        "mask 01": {"mask": 0x01},
        "mask 80": {"mask": 0x80},
        "mask 5A": {"mask": 0x5A},
        "all bits": {"custom": 0xFFFFFF},
        "top bit": {"custom": 0x800001},
        "zero": {"custom": 0},
        "record offset": {"sbt_offset": 0x123456},
        "mirrored": {},
        "turned": {},
        "stretched": {},
        "sheared": {},
        "inverted": {},
        "tiny": {},
        "turned boxes": {"shape": "boxes"},
        "boxes over a wall": {"shape": "boxes"},
        "wall in boxes": {},
        # Last, so that a driver that lets them hide others fails only the rules about that, in structure_checks.py.
        "inactive": {"active": False},
        "mask 00": {"mask": 0x00},
    }
    found: dict[str, Placement] = {}
    for place, (label, fields) in enumerate(told.items()):
        # Each instance is 10 to the right of the last one, with other heights and depths, so that a wrong translation
        # moves hits.
        matrix = np.zeros((3, 4))
        matrix[:, :3] = linear.get(label, np.eye(3))
        matrix[:, 3] = 10 * place, place % 3, -(place % 5)
        if label == "wall in boxes":  # halfway up the boxes, so that one ray meets both
            matrix[:, 3] = found["boxes over a wall"].transform[:, 3] + (0, 0, 0.5)
        # Custom indices differ from instance indices, so that a driver that confuses them is found out.
        default = {"shape": "opaque", "custom": 3 * place + 1}
        found[label] = Placement(**{**default, **fields}, transform=matrix)  # type: ignore[arg-type]
    return found


INSTANCES = _instances()


@dataclass(frozen=True)
class Expected:
    """The committed hit or the first candidate that a probe must find; t None allows any of its `among`."""

    kind: int
    t: float | None
    geometry: int = 0
    primitive: int | None = 0
    front: bool = True


@dataclass(frozen=True)
class Probe:
    """A ray in the object space of instance `on`, and what it must find there.

    committed: the hit, None when there must be none. candidate: the only candidate, if it is to be checked.
    candidates: how many candidates there must be, None where the documents leave it open. among: allowed distances,
    where several hits are right.
    """

    label: str
    rule: Rule
    on: str
    committed: Expected | None
    origin: tuple[float, float, float] = (0.5, 0.25, 2.0)
    direction: tuple[float, float, float] = (0.0, 0.0, -1.0)
    t_min: float = 0.0
    t_max: float = 100.0
    flags: int = 0
    mask: int = 0xFF
    action: int = CONFIRM
    parameter: float = 0.0
    candidate: Expected | None = None
    candidates: int | None = None
    among: tuple[float, ...] = ()


# Rules of ray flags, of the rayQuery functions, and of instance flags, which the wgpu document doesn't define.
flag_rule = partial(Rule, document=WGPU, section="Flags for RayDesc::flags")
call_rule = partial(Rule, document=WGPU, section="naga's raytracing API")
instance_rule = partial(Rule, document=VULKAN, section="VkGeometryInstanceFlagBitsKHR")


def ray_rule(name: str) -> Rule:
    """A rule of RayDesc."""
    return Rule(f"RayDesc.{name}", WGPU, "RayDesc")


def hit_rule(name: str) -> Rule:
    """A rule of RayIntersection."""
    return Rule(f"RayIntersection.{name}", WGPU, "RayIntersection")
