"""Poses of a simulator, whose z axis points up, as transforms of the scene, on the host and, by Warp, on the GPU."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from importlib import import_module, util
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.scene.files.mujoco.geoms import UP
from solari_vk.scene.matrices import quaternion_rotation


def on_device(values: Any) -> bool:
    """Whether an array is one of Warp, or lies on a GPU."""
    if type(values).__module__.partition(".")[0] == "warp":
        return True
    return hasattr(values, "__cuda_array_interface__")


def scene_poses(places: Any, axes: Any, numbers: Sequence[int]) -> Any:
    """Transforms (N, K, 4, 4) of positions (N, all, 3) and rotations (N, all, 3, 3). On a GPU of the K objects with
    these numbers, as an array of Warp; on the host of those that are given."""
    if on_device(places):
        return _by_warp(places, axes, numbers)
    found = np.tile(np.eye(4), (*places.shape[:2], 1, 1))
    found[..., :3, :3] = UP @ axes
    found[..., :3, 3] = places @ UP.T
    return found


def _by_warp(places: Any, axes: Any, numbers: Sequence[int]) -> Any:
    if util.find_spec("warp") is None:
        raise SolariError('poses on a GPU are turned there by Warp: install it by "pip install warp-lang"')
    wp = import_module("warp")
    places, axes = (_array(wp, values, kind) for values, kind in ((places, wp.vec3f), (axes, wp.mat33f)))
    shape = places.shape[0], len(numbers)
    # Warp's kernels keep to the stream of its device, as those of the simulation.
    found = wp.empty((*shape, 4, 4), dtype=wp.float32, device=places.device)
    which = wp.array(np.asarray(numbers, np.int32), dtype=wp.int32, device=places.device)
    wp.launch(_kernel(), dim=shape, inputs=[places, axes, which], outputs=[found], device=places.device)
    return found


def _array(wp: Any, values: Any, dtype: Any) -> Any:
    """An array of Warp (N, all) of vectors or matrices, in the memory of `values`."""
    if not isinstance(values, wp.array):
        values = wp.array(values, copy=False)
    if values.dtype == dtype:
        return values
    if values.dtype != wp.float32:
        raise SolariError(f"poses on a GPU are float32, not {values.dtype.__name__}: turn them into such")
    flat = values.contiguous()
    found = wp.array(ptr=flat.ptr, shape=values.shape[:2], dtype=dtype, device=values.device, copy=False)
    found.memory_of = flat  # lives as long
    return found


@cache
def _kernel() -> Any:
    import warp as wp

    @wp.kernel  # type: ignore[untyped-decorator]
    def turn_up(
        places: wp.array2d(dtype=wp.vec3f),  # type: ignore[valid-type]
        axes: wp.array2d(dtype=wp.mat33f),  # type: ignore[valid-type]
        numbers: wp.array1d(dtype=wp.int32),  # type: ignore[valid-type]
        found: wp.array4d(dtype=wp.float32),  # type: ignore[valid-type]
    ) -> None:
        world, index = wp.tid()
        place = places[world, numbers[index]]
        axis = axes[world, numbers[index]]
        # The rows of UP: x stays, z becomes y, and y becomes -z.
        for column in range(3):
            found[world, index, 0, column] = axis[0, column]
            found[world, index, 1, column] = axis[2, column]
            found[world, index, 2, column] = -axis[1, column]
            found[world, index, 3, column] = 0.0
        found[world, index, 0, 3] = place[0]
        found[world, index, 1, 3] = place[2]
        found[world, index, 2, 3] = -place[1]
        found[world, index, 3, 3] = 1.0

    return turn_up


def up_matrix(axis: int) -> NDArray[np.float64]:
    """The rotation (3, 3) from axes of which this one, 0 to 2, points up, to those of the scene."""
    turns = {0: [(0, -1, 0), (1, 0, 0), (0, 0, 1)], 1: np.eye(3), 2: UP}
    return np.array(turns[axis], np.float64)


def scene_transforms(up: Any, local: Any, bodies: Any = None, body_of: Any = None) -> NDArray[np.float64]:
    """Transforms (N, 4, 4) of Warp's transforms (N,): positions and quaternions, each in the frame of its body, of
    `bodies` with the number in `body_of`, or in the world for -1."""
    places, turns = _parts(local.numpy())
    if bodies is not None:
        number = body_of.numpy()
        body_places, body_turns = _parts(bodies.numpy())
        of_body = number >= 0
        moved = np.einsum("nij,nj->ni", body_turns[number], places) + body_places[number]
        places = np.where(of_body[:, None], moved, places)
        turns = np.where(of_body[:, None, None], body_turns[number] @ turns, turns)
    found = np.tile(np.eye(4), (len(places), 1, 1))
    found[:, :3, :3] = up @ turns
    found[:, :3, 3] = places @ up.T
    return found


def _parts(values: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The positions (N, 3) and rotations (N, 3, 3) of transforms of Warp (N, 7), whose quaternions have w last."""
    numbers = values.astype(np.float64)
    turns = np.array(quaternion_rotation(*numbers[:, 3:].T))
    return numbers[:, :3], np.moveaxis(turns, -1, 0)
