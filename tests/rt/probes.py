"""Rays for tests of acceleration structures and ray queries: arrays in, everything the document's getters say out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from solari_vk import rt
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Frame, Pass, Stage

GLSL = Path(__file__).parent / "glsl"
NONE, TRIANGLE, GENERATED, AABB = range(4)
CONFIRM, GENERATE, TERMINATE = 1, 2, 4
DOWN = np.array([0.0, 0.0, -1.0])


def trace(
    device: Device,
    tlas: rt.Tlas,
    origins: Any,
    directions: Any = DOWN,
    *,
    flags: Any = 0,
    cull_mask: Any = 0xFF,
    t_min: Any = 0.0,
    t_max: Any = 1e30,
    action: Any = CONFIRM,
    hit_t: Any = 1.0,
    hit_step: Any = 0.0,
    header: str = "",
    glsl: Path = GLSL,
    check: bool = True,
) -> np.ndarray:
    """The answer of every ray, with the fields of RayIntersection in "hit"; fails when a rule was broken."""
    origins, directions = np.broadcast_arrays(np.atleast_2d(origins), np.atleast_2d(directions))
    count = len(origins)
    debug = rt.RAY_QUERY_DEBUG in header
    faults = dict(rt.FAULT_BUFFERS) if debug else {}
    stage = Stage(
        "probe", buffers={"rays": count, "answers": count, **faults}, passes=[Pass("probe", count, header=header)]
    )
    with Frame(device, [stage], external={"tlas": tlas}, glsl_root=glsl) as frame:
        rays = np.zeros(count, frame.binding("rays").element)
        desc = rays["desc"]
        desc["origin"], desc["dir"], desc["flags"], desc["cull_mask"] = origins, directions, flags, cull_mask
        desc["t_min"], desc["t_max"], rays["action"] = t_min, t_max, action
        rays["hit_t"], rays["hit_step"] = hit_t, hit_step
        frame.resource("rays").upload(rays)
        frame.submit()
        answers = frame["answers"]
        if debug and check:
            rt.check_ray_queries(frame)
    return answers


def quad(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    """Two triangles without indices, facing +z, of the unit square at (x, y, z)."""
    a, b, c, d = ((x, y, z), (x + 1, y, z), (x + 1, y + 1, z), (x, y + 1, z))
    return np.array([a, b, c, a, c, d], np.float32)


def shifted(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    """A transform (3, 4) that moves."""
    return np.array([[1, 0, 0, x], [0, 1, 0, y], [0, 0, 1, z]], np.float32)
