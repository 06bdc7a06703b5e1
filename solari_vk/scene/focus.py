"""Where a camera is sharp, as photographers set it."""

from __future__ import annotations

from typing import Any

import numpy as np

from solari_vk.base.errors import SolariError, quoted
from solari_vk.scene.bounds import bounds_of
from solari_vk.scene.calibrated import lens_of


class Focused:
    """The part of `Camera` that focuses."""

    def focus_on(self: Any, target: Any, f_number: float, *, sensor_height: float = 0.024) -> Any:
        """Focus on a point (3,) in meters, at a distance in meters along the view axis, or on the middle of an
        instance's box, and return the camera.

        f_number: of a lens with this camera's field of view, on a sensor of this height in meters (full frame). Its
        focal length over the f-number is the aperture: f/1.4 blurs more than f/8. Raises SolariError for a target that
        isn't before the camera, an f-number that isn't positive, and orthographic cameras, panoramas and cubes, which
        have no focal length.
        """
        if hasattr(target, "posed_mesh"):
            box = bounds_of([target])
            target = box.center if box is not None else target
        try:
            given = np.asarray(target, np.float64)
        except (TypeError, ValueError):
            raise SolariError(f"Camera.focus_on: target is a point (3,) or a distance, not {quoted(target)}") from None
        back = self.transform[:3, 2] / np.linalg.norm(self.transform[:3, 2])
        if given.shape not in ((), (3,)):
            raise SolariError(f"Camera.focus_on: target is a point (3,) or a distance, not of the shape {given.shape}")
        away = self.transform[:3, 3] - given if given.shape == (3,) else given
        wide = given.shape == (3,) and self.projection != "perspective"
        distance = float(np.linalg.norm(away) if wide else away @ back if given.shape == (3,) else given)
        has_none = self.orthographic_height or self.projection in ("equirectangular", "cube")
        if not distance > 0 or not f_number > 0 or has_none:
            raise SolariError(
                "Camera.focus_on: a camera with a focal length, a target before it and a positive "
                f"f-number are needed, not {distance:g} m and f/{f_number}"
            )
        focal_length = sensor_height / 2 / lens_of(self, (1, 1)).half[1]
        self.update(focus_distance=distance, aperture=focal_length / f_number)
        return self
