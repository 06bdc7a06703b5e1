"""Boxes of instances in space, along their own axes, and their poses before a camera."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, checked_keywords, quoted
from solari_vk.scene.bounds import Bounds
from solari_vk.scene.matrices import transform_points
from solari_vk.scene.model import Camera, Instance
from solari_vk.scene.objects import objects_of

Floats = NDArray[np.float64]


class Box3D(NamedTuple):
    """The smallest box around an instance in its pose, along the axes of its `rotation`."""

    center: Floats
    """(3,) in meters, in the camera's frame as OpenCV has it: x right, y down, z forward."""
    rotation: Floats
    """(3, 3), from the box's axes to the camera's frame; it doesn't mirror."""
    size: Floats
    """The lengths of the sides, (3,) in meters."""
    corners: Floats
    """(8, 3) in meters in the world: lowest x, y and z first, z changes fastest."""
    pixels: Floats
    """Where the corners are in the picture, (8, 2) as `Camera.project` has it; NaN for those that aren't seen."""


@checked_keywords(who="solari_vk")
def boxes_3d(
    instances: Iterable[Instance], camera: Camera, size: tuple[int, int], *, merge: bool = False
) -> dict[Instance, Box3D]:
    """The box of each instance, such as those of `scene.instances`, for a camera's picture of this size.

    They are exact for what joints and morph targets move, and for transforms that scale, mirror or shear. merge: one
    box around all parts of an object that have one label (`Instance.part_of`), by its first part. Raises SolariError
    for what isn't an instance.
    """
    numbered = dict(enumerate(instances if isinstance(instances, Iterable) else [instances]))
    for item in numbered.values():
        if not isinstance(item, Instance):
            raise SolariError(f"boxes_3d: takes instances, such as group.items, not {quoted(item)}")
    # Parts of an object that have different labels stay objects of their own.
    labels = {number: instance.label for number, instance in numbered.items()}
    objects = objects_of(numbered, labels, merge=merge)
    return {
        numbered[first]: box_around([numbered[part] for part in parts], camera, size)
        for first, parts in objects.items()
    }


def box_around(parts: Sequence[Instance], camera: Camera, size: tuple[int, int]) -> Box3D:
    """The box of an object, along the axes of its first part."""
    to_camera, shift = camera.extrinsics()
    axes = parts[0].rotation
    positions = np.concatenate([transform_points(part.transform, part.posed_mesh().positions) for part in parts])
    # The columns of a rotation are its axes, so this product gives the coordinates along them.
    along = positions @ axes
    bounds = Bounds(along.min(axis=0), along.max(axis=0))
    corners = bounds.corners @ axes.T
    center = to_camera @ (axes @ bounds.center) + shift
    return Box3D(center, to_camera @ axes, bounds.size, corners, camera.project(corners, size))
