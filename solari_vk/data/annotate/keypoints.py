"""Named points on instances, where they are in a picture, and whether they are seen."""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.base.errors import SolariError, checked_keywords, quoted, unknown_name
from solari_vk.base.files import read_json
from solari_vk.data.annotate.surfaces import check_view, is_blocked, is_inside
from solari_vk.renderers.ray_tracer import RayTracer
from solari_vk.scene.matrices import transform_points
from solari_vk.scene.model import Camera, Instance
from solari_vk.scene.objects import is_called, objects_of

OUTSIDE, OCCLUDED, VISIBLE = range(3)
"""States of keypoints, as COCO's v: not in the picture, hidden by a surface, seen."""
OWN_SURFACE = 1e-3  # of the distance: joints and vertices lie a little below the surface that shows them
Point = ArrayLike | int
Named = Mapping[str, Mapping[str, Point]]


class Keypoint(NamedTuple):
    """A point of an instance in a picture."""

    pixel: NDArray[np.float64]
    """(2,) as `Camera.project` has it; NaN for what the camera doesn't see."""
    state: int
    """0: not in the picture; 1: hidden by a surface; 2: seen. These are COCO's numbers."""
    position: NDArray[np.float64]
    """(3,) in meters in the world."""


@checked_keywords(who="solari_vk")
def keypoints(
    tracer: RayTracer,
    camera: Camera,
    size: tuple[int, int],
    points: Named | str | PathLike[str],
    *,
    tolerance: float = 0.0,
    instances: Sequence[Instance] | None = None,
) -> dict[Instance, dict[str, Keypoint]]:
    """Named points of the scene's visible instances in a camera's picture of this size.

    points: for patterns of instances' names, such as "Chair*", the points by name: (3,) in meters in the mesh's own
    space, or the number of a vertex, which follows joints and morph targets; or a JSON file of that. Of several
    patterns that fit, the first counts, and of an object's parts the first that fits has them. tolerance: how far
    before a point, in meters, a surface counts as its own, as for joints below skin; always a thousandth of the
    distance. instances: those whose names count; None: all. Raises SolariError for a pattern that fits no name, and for
    a point that is neither.
    """
    check_view("keypoints", tracer, camera, size)
    positions = list[NDArray[np.float64]]()
    names = list[tuple[Instance, str]]()
    tracer.trace(np.zeros((0, 3)), np.zeros((0, 3)))  # without rays it only applies the scene's edits
    candidates = list(tracer.instances.values()) if instances is None else instances
    for instance, named in find_keypoints(candidates, points).items():
        if not instance.visible:
            continue
        # Vertices are numbered in the mesh as joints and morph targets have moved it.
        mesh = instance.posed_mesh()
        for name, point in named.items():
            local = _local(point, mesh.positions, f"keypoints: {name!r} of {instance.describe()}")
            positions.append(transform_points(instance.transform, local[None])[0])
            names.append((instance, name))
    if not names:
        return {}
    world = np.array(positions)
    pixels = camera.project(world, size)
    slack = tolerance + OWN_SURFACE * np.linalg.norm(world - camera.position, axis=-1)
    blocked = is_blocked(tracer, camera, world, pixels, size, slack)
    states = np.where(is_inside(pixels, size), np.where(blocked, OCCLUDED, VISIBLE), OUTSIDE)
    found = dict[Instance, dict[str, Keypoint]]()
    for (instance, name), pixel, state, position in zip(names, pixels, states.tolist(), world, strict=True):
        found.setdefault(instance, {})[name] = Keypoint(pixel, state, position)
    return found


def find_keypoints(instances: Sequence[Instance], points: Any) -> dict[Instance, Mapping[str, Point]]:
    """The named points of each instance that a pattern fits; arguments and errors are those of `keypoints`."""
    who = "keypoints"
    if isinstance(points, str | PathLike):
        who = f"keypoints {Path(points)}"
        points = read_json(Path(points), who)
    if not isinstance(points, Mapping) or not all(isinstance(named, Mapping) for named in points.values()):
        raise SolariError(
            f'{who}: give points by name for patterns of names, such as {{"Chair*": {{"seat": [0, 0.4, 0]}}}}'
        )
    found = dict[Instance, Mapping[str, Point]]()
    for pattern, named in points.items():
        for instance in _fitting(instances, pattern, who):
            found.setdefault(instance, named)  # of several patterns that fit, the first counts
    # All points are checked here, before anything is rendered: `dataset` calls this first.
    for instance, named in found.items():
        for name, point in named.items():
            _local(point, instance.mesh.positions, f"{who}: {name!r} of {instance.describe()}")
    return found


def _fitting(instances: Sequence[Instance], pattern: Any, who: str) -> list[Instance]:
    """The instances that a pattern fits, of an object's parts the first one. Raises SolariError if there are none."""
    if not isinstance(pattern, str):
        raise SolariError(f"{who}: a pattern of names is text, not {quoted(pattern)}")
    numbered = dict(enumerate(instance for instance in instances if is_called(instance, pattern)))
    if not numbered:
        raise unknown_name(f"{who}: no instance is named", pattern, [instance.name for instance in instances])
    return [numbered[first] for first in objects_of(numbered)]


def _local(point: Any, positions: NDArray[Any], who: str) -> NDArray[np.float64]:
    """A point (3,) in the mesh's space."""
    # A whole number is a vertex, three numbers are a place; a float or a text is neither.
    try:
        if np.ndim(point) == 0:
            number = operator.index(point)
            if not 0 <= number < len(positions):
                raise ValueError
            return np.asarray(positions[number], np.float64)
        place = np.asarray(point, np.float64)
        if place.shape != (3,) or not np.isfinite(place).all():
            raise ValueError
        return place
    except (TypeError, ValueError):
        raise SolariError(
            f"{who}: is three numbers, or a vertex from 0 to {len(positions) - 1}, not {quoted(point)}"
        ) from None
