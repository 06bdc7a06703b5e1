"""Where objects, lights and cameras are, as a transform, and what puts them elsewhere. Needs no window."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene.model import Instance
from solari_vk.scene.observable import Checked
from solari_vk.scene.placement import Placed

OUTSIDE = 0.01  # of a mesh's size, how far its origin may lie outside of its bounds and count as inside


def pivot_of(item: Any) -> NDArray[np.float64]:
    """The point (3,) in its own space that an object turns about and is scaled from: its origin, but the middle of an
    instance's mesh if the origin lies outside of that."""
    if not isinstance(item, Instance):
        return np.zeros(3)
    positions = item.mesh.positions
    low, high = positions.min(axis=0).astype(np.float64), positions.max(axis=0).astype(np.float64)
    slack = OUTSIDE * np.linalg.norm(high - low)
    is_inside = (low <= slack).all() and (high >= -slack).all()
    return np.zeros(3) if is_inside else (low + high) / 2


def move_to(item: Checked, transform: NDArray[np.float64]) -> dict[str, Any]:
    """The fields of an instance, a camera or a light, if it had a transform (4, 4), along whose -z axis a light
    shines."""
    if isinstance(item, Placed):
        return {"transform": transform}
    fields: dict[str, Any] = {}
    if hasattr(item, "position"):
        fields["position"] = transform[:3, 3]
    if hasattr(item, "direction"):
        fields["direction"] = -transform[:3, 2] / np.linalg.norm(transform[:3, 2])
    return fields


def transform_of(item: Checked, fallback: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """The transform (4, 4) that `move_to` takes, None for what has no place. fallback: the position (3,) of what only
    has a direction, such as a sun."""
    if isinstance(item, Placed):
        return item.transform
    if not hasattr(item, "position") and not hasattr(item, "direction"):
        return None
    back = -np.asarray(getattr(item, "direction", (0, 0, -1)), np.float64)
    # Any axes that make a rotation with the direction. Near the vertical another up vector keeps the product long.
    is_steep = abs(back[1]) >= math.cos(0.05) * np.linalg.norm(back)
    up = np.array((0.0, 0.0, 1.0) if is_steep else (0.0, 1.0, 0.0))
    right = np.cross(up, back)
    made = np.eye(4)
    made[:3, :3] = np.stack([axis / np.linalg.norm(axis) for axis in (right, np.cross(back, right), back)], axis=1)
    made[:3, 3] = getattr(item, "position", fallback)
    return made
