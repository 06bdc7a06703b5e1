"""Cameras."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.errors import SolariError
from solari_vk.scene import checks
from solari_vk.scene.checks import FloatArray
from solari_vk.scene.observed import Checked


@dataclass(eq=False, kw_only=True)
class Camera(Checked):
    """A perspective camera looking along its -z axis, +y up.

    transform is world from camera, (4, 4); vertical_fov in radians; ev100 is the exposure value at
    ISO 100: pictures show radiance / (1.2 * 2^ev100); jitter shifts the picture by a part of a pixel.
    """

    transform: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))
    vertical_fov: float = math.radians(45)
    near: float = 0.01
    ev100: float = 0.0
    jitter: FloatArray = field(default_factory=lambda: np.zeros(2, np.float32))
    name: str = ""

    _converters = {
        "name": checks.text,
        "transform": checks.affine_transform,
        "vertical_fov": checks.number(1e-4, math.pi - 1e-4),
        "near": checks.number(1e-9, checks.LARGEST_COORDINATE),
        "ev100": checks.number(-100, 100),
        "jitter": checks.array(2),
    }

    @classmethod
    def look_at(cls, position: ArrayLike, target: ArrayLike, up: ArrayLike = (0, 1, 0), **fields: Any) -> Camera:
        """A camera at a position looking at a target; the other fields as in the constructor."""
        eye = np.asarray(position, np.float64)
        back = eye - np.asarray(target, np.float64)
        right = np.cross(np.asarray(up, np.float64), back)
        if not np.linalg.norm(back) > 0 or not np.linalg.norm(right) > 0:
            raise SolariError("Camera: position and target must differ, and up must not lie along the view")
        transform = np.eye(4)
        transform[:3, 2] = back / np.linalg.norm(back)
        transform[:3, 0] = right / np.linalg.norm(right)
        transform[:3, 1] = np.cross(transform[:3, 2], transform[:3, 0])
        transform[:3, 3] = eye
        return cls(transform=transform, **fields)

    @classmethod
    def from_pose(cls, pose: Any) -> Camera:
        """A camera from what `pose` gave, or from {"position": [x, y, z], "target": [x, y, z]}.

        Also takes "up", "vertical_fov_degrees", "near" and "ev100", or a whole "transform" for position and target.
        """
        known = {"position", "target", "up", "transform", "vertical_fov_degrees", "near", "ev100"}
        if not isinstance(pose, dict) or not known.issuperset(pose):
            raise SolariError(f"a camera pose is a JSON object of {', '.join(sorted(known))}, not {pose!r}")
        try:
            fields: dict[str, Any] = {name: float(pose[name]) for name in ("near", "ev100") if name in pose}
            if "vertical_fov_degrees" in pose:
                fields["vertical_fov"] = math.radians(pose["vertical_fov_degrees"])
            if "transform" in pose:
                return cls(transform=pose["transform"], **fields)
            return cls.look_at(pose["position"], pose["target"], pose.get("up", (0, 1, 0)), **fields)
        except (KeyError, TypeError, ValueError) as error:
            raise SolariError(f"a camera pose needs 'position' and 'target', or 'transform': {error}") from None

    def pose(self) -> dict[str, Any]:
        """What `from_pose` takes, as plain JSON values."""
        return {
            "transform": self.transform.tolist(),
            "vertical_fov_degrees": math.degrees(self.vertical_fov),
            "near": self.near,
            "ev100": self.ev100,
        }

    @property
    def exposure(self) -> float:
        """The factor from radiance to the picture's values."""
        return float(1.0 / (1.2 * 2.0**self.ev100))
