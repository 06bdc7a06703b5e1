"""Camera paths: an orbit around a point, and a curve through the poses of a JSON file. Pure numpy."""

from __future__ import annotations

import dataclasses
import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.base.errors import SolariError
from solari_vk.base.files import read_json
from solari_vk.scene.matrices import nearest_rotation, rotation, turned_about, unit
from solari_vk.scene.model import Camera

MAX_CAMERAS = 100_000
LATEST = 1e9  # seconds: the curves through much later or closer poses overflow
MAX_TURN = 170.0  # degrees between successive poses: a turn by 180 degrees has no unique direction


def orbit(camera: Camera, center: ArrayLike, count: int, sweep_degrees: float | None = None) -> list[Camera]:
    """`count` cameras that go once around the vertical axis through `center`.

    With `sweep_degrees` they swing through that angle and back instead. One step after the last camera comes the first
    again, so that the movie can loop.
    """
    turns = orbit_turns(count, sweep_degrees)
    transforms = (turned_about(center, rotation((0, 1, 0), turn), camera.transform) for turn in turns)
    return [_camera(camera, transform, camera.vertical_fov, camera.ev100) for transform in transforms]


def orbit_turns(count: int, sweep_degrees: float | None = None) -> NDArray[np.float64]:
    """The angles of the cameras of `orbit`, in radians about the vertical axis, (count,)."""
    turns = 2 * math.pi * np.arange(count) / count
    return turns if sweep_degrees is None else math.radians(sweep_degrees) / 2 * np.sin(turns)


def load_path(path: str | Path, camera: Camera, *, fps: float, count: int | None = None) -> list[Camera]:
    """Cameras along the poses of a JSON file: `fps` for each second, or `count` of them if given.

    The file is a list of poses as Camera.from_pose takes them. All have a "time" in seconds or none has: then the poses
    are one second apart. Values that a pose omits, and the lens, are those of `camera`. Position, orientation, field of
    view and exposure follow cubic Hermite curves through the poses. Raises SolariError for any other file.
    """
    times, poses = _read(Path(path), camera)
    if count is None:
        count = round((times[-1] - times[0]) * fps) + 1
    if count > MAX_CAMERAS:
        raise SolariError(f"{path}: {count:,} pictures are more than {MAX_CAMERAS:,}: give --frames or less time")
    frame_times = np.linspace(times[0], times[-1], count)
    channels = {
        "transform": np.array([pose.transform for pose in poses]),
        # So that a curve can't leave the range of angles from 0 to 360 degrees.
        "fov": np.array([math.log(math.tan(pose.vertical_fov / 4)) for pose in poses]),
        "ev100": np.array([pose.ev100 for pose in poses]),
    }
    # A path without exposures leaves that of the camera, which may be metered.
    has_exposures = any(pose.has_exposure for pose in poses)
    curves = {name: _interpolate(times, values, frame_times) for name, values in channels.items()}
    cameras = []
    for transform, fov, ev100 in zip(curves["transform"], curves["fov"], curves["ev100"], strict=True):
        # The mean of two rotations is none, and rounding leaves the last row near (0, 0, 0, 1).
        transform[:3, :3] = nearest_rotation(transform[:3, :3])
        transform[3] = (0, 0, 0, 1)
        try:
            exposure = float(ev100) if has_exposures else camera.ev100
            cameras.append(_camera(camera, transform, 4 * math.atan(math.exp(fov)), exposure))
        except SolariError as error:  # curves overshoot
            raise SolariError(f"{path}: the curve between its poses leaves the range of a camera: {error}") from None
    return cameras


def _read(path: Path, camera: Camera) -> tuple[NDArray[np.float64], list[Camera]]:
    items = read_json(path, f"{path}: a camera path")
    if not isinstance(items, list) or len(items) < 2 or not all(isinstance(item, dict) for item in items):
        raise SolariError(f"{path}: a camera path is a JSON list of at least two poses")
    if len(items) > MAX_CAMERAS:
        raise SolariError(f"{path}: it has {len(items):,} poses; at most {MAX_CAMERAS:,} are read")
    times = _read_times(path, items)
    poses = [_pose(path, index, item, camera) for index, item in enumerate(items)]
    for index, (a, b) in enumerate(pairwise(poses)):
        # The trace of the rotation from one pose to the next is 1 + 2 cos(angle).
        cosine = (np.sum(_axes(a) * _axes(b)) - 1) / 2
        if cosine < math.cos(math.radians(MAX_TURN)):
            raise SolariError(f"{path}: poses {index} and {index + 1} face opposite directions: add a pose between")
    return times, poses


def _read_times(path: Path, items: list[dict[str, Any]]) -> NDArray[np.float64]:
    timed = sum("time" in item for item in items)
    if timed not in (0, len(items)):
        raise SolariError(f"{path}: {timed} of {len(items)} poses have a 'time': give it to all or to none")
    try:
        times = np.array([float(item.get("time", index)) for index, item in enumerate(items)])
    except (TypeError, ValueError, OverflowError):
        raise SolariError(f"{path}: a pose's 'time' must be a number of seconds") from None
    if not ((np.abs(times) <= LATEST).all() and (np.diff(times) >= 1 / LATEST).all()):
        raise SolariError(
            f"{path}: the times of poses must be finite, within {LATEST:g} s, and increase from pose to "
            f"pose, by {1 / LATEST:g} s or more"
        )
    return times


def _pose(path: Path, index: int, item: dict[str, Any], camera: Camera) -> Camera:
    known = {"vertical_fov_degrees": math.degrees(camera.vertical_fov), **camera.lens_fields()}
    if camera.has_exposure:
        known["ev100"] = camera.ev100
    try:
        return Camera.from_pose(known | {key: value for key, value in item.items() if key != "time"})
    except SolariError as error:
        raise SolariError(f"{path}: pose {index}: {error}") from None


def _axes(camera: Camera) -> NDArray[np.float64]:
    """The camera's axes (3, 3), one a row, without their lengths."""
    return unit(camera.transform[:3, :3].T)


def _interpolate(
    times: NDArray[np.float64], values: NDArray[np.float64], wanted_times: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Cubic Hermite curves through values (n, ...) at times (n,), evaluated at wanted_times (m,).

    The slope at a pose is that of the parabola through the pose and its neighbors.
    """
    # numpy's second-order differences are these slopes, also where times aren't evenly spaced.
    slopes = np.gradient(values, times, axis=0)
    first = np.clip(np.searchsorted(times, wanted_times, side="right") - 1, 0, len(times) - 2)
    shape = (-1, *[1] * (values.ndim - 1))
    step = np.diff(times)[first].reshape(shape)
    t = (wanted_times - times[first]).reshape(shape) / step
    start, end = values[first], values[first + 1]
    # The cubic Hermite basis: weights of both values, then of both slopes.
    return np.asarray(
        start
        + (3 * t**2 - 2 * t**3) * (end - start)
        + step * (t * (1 - t) ** 2 * slopes[first] + t**2 * (t - 1) * slopes[first + 1])
    )


def _camera(like: Camera, transform: NDArray[np.float64], vertical_fov: float, ev100: float) -> Camera:
    return dataclasses.replace(like, transform=transform, vertical_fov=vertical_fov, ev100=ev100)
