"""Cameras of a stage."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from pxr import UsdGeom

from solari_vk.base.errors import SolariError
from solari_vk.scene.files.gltf.report import Report
from solari_vk.scene.files.usd.motion import Matrix
from solari_vk.scene.matrices import upright
from solari_vk.scene.model import Camera

_TENTH = 0.1  # of the stage's unit: that of lenses and films
_EXPOSURE = ("exposure", "exposure:time", "exposure:iso", "exposure:fStop", "exposure:responsivity")
LENS = (
    "focalLength",
    "clippingRange",
    "horizontalAperture",
    "verticalAperture",
    "horizontalApertureOffset",
    "verticalApertureOffset",
    "focusDistance",
    "fStop",
    *_EXPOSURE,
)
_SMALLEST, _LARGEST = 1e-4, math.pi - 1e-4  # radians


def make_camera(prim: Any, world: Matrix, time: Any, unit: float, report: Report) -> Camera:
    """The camera of a prim. unit: of the stage, in meters. Raises SolariError for one without a direction."""
    place = upright(world)
    if place is None:
        raise SolariError(f"<{prim.GetPath()}> has a transform that isn't finite or has a scale of 0")
    camera = UsdGeom.Camera(prim)
    if camera.GetStereoRoleAttr().Get() not in (None, "mono"):
        report.add("stereo roles of cameras have no effect", f"<{prim.GetPath()}>")
    if camera.GetClippingPlanesAttr().Get(time):
        report.add("clipping planes of cameras have no effect", f"<{prim.GetPath()}>")
    return Camera(transform=place, name=prim.GetName(), **lens(prim, time, unit))


def lens(prim: Any, time: Any, unit: float) -> dict[str, Any]:
    """The fields of a camera at a time that the lens, the film and the exposure make, the same ones at each time."""
    camera = UsdGeom.Camera(prim)
    width, height = (
        float(camera.GetPrim().GetAttribute(f"{side}Aperture").Get(time)) for side in ("horizontal", "vertical")
    )
    focal = float(camera.GetFocalLengthAttr().Get(time))
    if not (0 < height < math.inf and 0 < width < math.inf and 0 < focal < math.inf):
        raise SolariError(f"<{prim.GetPath()}> needs a focal length and apertures above 0")
    offsets = np.array(
        [camera.GetHorizontalApertureOffsetAttr().Get(time), camera.GetVerticalApertureOffsetAttr().Get(time)]
    )
    # The film moves to the right and up, so that the view axis is left of and below its middle.
    fields: dict[str, Any] = {"principal_point": 0.5 + offsets / (width, height) * (-1, 1)}
    if camera.GetProjectionAttr().Get(time) == UsdGeom.Tokens.orthographic:
        fields["orthographic_height"] = height * _TENTH * unit
    else:
        fields["vertical_fov"] = min(max(2 * math.atan(height / 2 / focal), _SMALLEST), _LARGEST)
        stop, distance = float(camera.GetFStopAttr().Get(time)), float(camera.GetFocusDistanceAttr().Get(time)) * unit
        is_sharp = stop <= 0 or distance <= 1e-9
        fields["aperture"] = 0.0 if is_sharp else focal * _TENTH * unit / stop
        fields["focus_distance"] = max(distance, 1e-9) if distance > 0 else 1.0
    # Depths of orthographic cameras are ratios to the near plane's, which may be at 0.
    near = float(camera.GetClippingRangeAttr().Get(time)[0]) * unit
    fields["near"] = min(max(near, 1e-6 * fields.get("orthographic_height", 0.0), 1e-9), 1e15)
    if any(prim.GetAttribute(name).HasAuthoredValue() for name in _EXPOSURE):
        # Pictures of a stage show nits times this scale, those of the scene divide by 1.2 2^EV100.
        scale = float(camera.ComputeLinearExposureScale(time))
        if 0 < scale < math.inf:
            fields["ev100"] = min(max(-math.log2(1.2 * scale), -100.0), 100.0)
    return fields
