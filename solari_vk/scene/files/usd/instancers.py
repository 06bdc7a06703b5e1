"""The points of a point instancer."""

from __future__ import annotations

from typing import Any

import numpy as np
from pxr import Usd, UsdGeom

from solari_vk.base.budget import charge
from solari_vk.base.errors import SolariError
from solari_vk.scene.files.gltf.report import Report
from solari_vk.scene.files.usd.motion import Matrix, Motion, sampled

MOVING = ("positions", "orientations", "orientationsf", "scales")
_BYTES_PER_POINT = 128


def repetitions(
    instancer: Any, count: int, motion: Motion, report: Report, who: str
) -> tuple[bool, list[float], Matrix]:
    """Whether points move, the time codes, and matrices (K, N, 4, 4) of N = `count` points at these, or at rest."""
    place = f"<{instancer.GetPath()}>"
    codes = motion.codes(sampled({name: instancer.GetPrim().GetAttribute(name) for name in MOVING}))
    times = [Usd.TimeCode(code) for code in codes] or [motion.time]
    charge(_BYTES_PER_POINT * count * len(times), f"{who}: {place}", f"{count:,} points")
    leave, all_points = UsdGeom.PointInstancer.ExcludeProtoXform, UsdGeom.PointInstancer.IgnoreMask
    if any(primvar.GetInterpolation() != "constant" for primvar in UsdGeom.PrimvarsAPI(instancer).GetPrimvars()):
        report.add("primvars of points of instancers have no effect", place)
    found: list[Matrix] = []
    for time in times:
        made = instancer.ComputeInstanceTransformsAtTime(time, time, leave, all_points)
        rows = np.array(made, np.float64).reshape(-1, 4, 4).swapaxes(1, 2)
        if len(rows) != count or not np.isfinite(rows).all():
            if not found:
                raise SolariError(f"{who}: {place} has wrong numbers of positions, or some that aren't finite")
            report.add("points that come and go are shown as at the start", place)
            return False, [], np.array(found[:1])
        found.append(rows)
    return bool(codes), codes, np.array(found)
