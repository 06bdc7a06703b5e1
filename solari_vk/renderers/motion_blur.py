"""Motion blur: what a renderer has to show the scene at the times at which a shutter is open."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple

from solari_vk.base.errors import SolariError, quoted
from solari_vk.scene.model import Camera, Scene
from solari_vk.scene.shutter import Shutter

PoseCallback = Callable[[float], Any]
"""Poses the scene at a time in seconds, and may return the camera."""

# The values of the uniform `shutter_state`, as in glsl/scene/camera_records.glsl.
FIRST = 1
LATER = 2
AFTER = 3


class ShutterUniforms(NamedTuple):
    """What the shaders of a realtime frame know of its exposure."""

    state: int
    """FIRST or LATER of the frames of an exposure, or AFTER: the first frame without a shutter after one."""
    rows: tuple[int, int]
    """The rows that the frame exposes: the first one, and the one after the last."""


def checked_pose(scene: Scene, shutter: Any, pose: Any, who: str) -> PoseCallback:
    """What poses the scene during an exposure. Raises SolariError if nothing does, and for what is no shutter."""
    if not isinstance(shutter, Shutter):
        raise SolariError(
            f"{who}.render: shutter is a solari_vk.Shutter, not {quoted(shutter)}: Shutter(close=1/48) is one"
        )
    if pose is None and not len(scene.animations):
        raise SolariError(
            f"{who}.render: {scene.describe()} has no animations: give pose, a function that poses "
            "the scene at a time, and may return the camera"
        )
    if pose is not None and not callable(pose):
        raise SolariError(f"{who}.render: pose is a function of the time in seconds, not {quoted(pose)}")
    return scene.animate if pose is None else pose


def pose_after_error(pose: PoseCallback, shutter: Shutter) -> None:
    """Leave the scene as in the middle of an exposure that failed; errors of `pose` don't hide the first one."""
    with suppress(Exception):
        pose(shutter.middle)


class CallbackCameras:
    """The cameras that a renderer is given: by its caller, or by pose callbacks, which may make a new one each time.

    The exposure that auto_exposure chose for one camera of a pose is that of the next ones, or pictures would flicker.
    """

    def __init__(self) -> None:
        self._metered_camera: Camera | None = None  # the latest camera of a pose whose exposure was chosen

    def pose(self, pose: PoseCallback, seconds: float, camera: Camera) -> Camera:
        """Set the scene to a time; returns the camera then, which is `camera` unless `pose` returns another."""
        posed = pose(seconds)
        if not isinstance(posed, Camera) or posed is camera:
            return camera
        metered = self._metered_camera
        # A new object begins with its default exposure, though it is the same camera at another time.
        if posed.auto_exposure and metered is not None and posed is not metered:
            posed.update(ev100=metered.ev100, auto_exposure=metered.auto_exposure)
        return posed

    def remember(self, shown: Camera, camera: Camera) -> None:
        """Remember the camera that a frame shows as the one whose exposure is chosen, if a pose returned it. camera:
        that of the caller."""
        if shown.auto_exposure and shown is not camera:
            self._metered_camera = shown


class ShutterAccumulation:
    """The exposure of a shutter, whose frames a realtime renderer accumulates.

    With a shutter each frame shows the scene at one time of the exposure, so that surfaces are sharp for the denoiser,
    and the picture is the mean of the frames: Haeberli and Akeley, "The Accumulation Buffer" (1990).
    """

    def __init__(self) -> None:
        self.device_is_behind = False
        """Whether the host has posed the scene as in the middle of the exposure since the device took it."""
        self._latest_key: tuple[Any, ...] | None = None  # the latest frames' shutter, pose and view

    def begin_frame(self, key: tuple[Any, ...], rows: tuple[int, int]) -> ShutterUniforms:
        """The uniforms of a frame of an exposure. key: its shutter, pose and view; another begins a new exposure."""
        state = LATER if key == self._latest_key else FIRST
        self._latest_key = None  # so that the exposure begins anew if the frame fails
        return ShutterUniforms(state, rows)

    def finish_frame(self, key: tuple[Any, ...]) -> None:
        """Count the frame that was begun."""
        self._latest_key = key
        self.device_is_behind = True

    def after(self, height: int) -> ShutterUniforms | None:
        """The uniforms of a frame without a shutter: after an exposure it begins a new picture."""
        return None if self._latest_key is None else ShutterUniforms(AFTER, (0, height))

    def end(self) -> None:
        """There was a frame without a shutter."""
        self._latest_key = None
        self.device_is_behind = False
