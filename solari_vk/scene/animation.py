"""Animations: keyframes for the nodes of a rig, as in glTF, and the times at which they are played."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from solari_vk.errors import SolariError
from solari_vk.scene import checks
from solari_vk.scene.observed import Checked, checked
from solari_vk.scene.rig import Rig

if TYPE_CHECKING:
    from solari_vk.scene.model import Scene

Values = NDArray[np.float64]
INTERPOLATIONS = ("LINEAR", "STEP", "CUBICSPLINE")
WIDTHS = {"translation": 3, "rotation": 4, "scale": 3, "visible": 1, "weights": None}
"""What a channel changes, and how many numbers a key has: a mesh has any number of morph targets."""


@dataclass(frozen=True)
class Channel:
    """The keys of one property of a rig's node. Raises SolariError for keys that can't be played.

    times (K,): in seconds, ascending. values (K, C): translations in meters, unit quaternions (x, y, z, w), scales,
    visibility (more than 0), or the weights of morph targets. For CUBICSPLINE (K, 3, C): each key's incoming tangent,
    value and outgoing tangent, tangents per second.
    """

    node: int
    path: str
    times: Sequence[float]
    values: Values
    interpolation: str = "LINEAR"

    def __post_init__(self) -> None:
        if self.path not in WIDTHS or self.interpolation not in INTERPOLATIONS:
            raise SolariError(f"an animation's channel can't have {self.interpolation} keys of '{self.path}'")
        times = np.asarray(self.times, np.float64)
        values = np.array(self.values, np.float64)
        if times.ndim != 1 or not len(times):
            raise SolariError(f"the {self.path} of an animation needs times (K,) of at least one key")
        shape = (len(times), 3) if self.interpolation == "CUBICSPLINE" else (len(times),)
        width = WIDTHS[self.path]
        if values.shape[:-1] != shape or (width is not None and values.shape[-1] != width):
            wanted = ", ".join(map(str, (*shape, "C" if width is None else width)))
            raise SolariError(f"the {self.path} of an animation has values {values.shape}, but must have ({wanted})")
        finite = np.isfinite(times).all() and np.isfinite(values).all()
        if not (finite and times[0] >= 0 and (np.diff(times) >= 0).all()):
            raise SolariError(f"the {self.path} of an animation has keys that aren't finite or whose times descend")
        object.__setattr__(self, "times", times.tolist())
        object.__setattr__(self, "values", values)

    def at(self, seconds: float) -> Values:
        """The value (C,) at a time; before the first key that of the first, after the last key that of the last."""
        times, cubic = self.times, self.interpolation == "CUBICSPLINE"
        keys = self.values[:, 1] if cubic else self.values
        index = bisect_right(times, seconds) - 1
        if index < 0 or index == len(times) - 1 or self.interpolation == "STEP":
            return self._fit(keys[max(index, 0)])
        span = times[index + 1] - times[index]
        t = (seconds - times[index]) / span
        before, after = keys[index], keys[index + 1]
        if not cubic:
            if self.path == "rotation":
                return slerp(before, after, t)
            return self._fit((1 - t) * before + t * after)
        leaving, arriving = self.values[index, 2], self.values[index + 1, 0]
        rest = 1 - t
        value = (1 + 2 * t) * rest**2 * before + t**2 * (3 - 2 * t) * after
        return self._fit(value + span * t * rest * (rest * leaving - t * arriving))

    def _fit(self, value: Values) -> Values:
        return unit_quaternion(value) if self.path == "rotation" else value


def unit_quaternion(value: Values) -> Values:
    """A quaternion (4,) with its length made 1; no rotation for one of zero length."""
    length = math.hypot(*value)
    return value / length if length > 0 else np.array((0.0, 0.0, 0.0, 1.0))


def slerp(a: Values, b: Values, t: float) -> Values:
    """Quaternions (4,) interpolated along the shorter arc, at constant speed: Shoemake, "Animating Rotation with
    Quaternion Curves" (1985)."""
    a, b = unit_quaternion(a), unit_quaternion(b)
    cosine = float(a @ b)
    if cosine < 0:
        b, cosine = -b, -cosine
    angle = math.acos(min(cosine, 1.0))
    if angle < 1e-6:
        return unit_quaternion((1 - t) * a + t * b)
    return unit_quaternion((math.sin((1 - t) * angle) * a + math.sin(t * angle) * b) / math.sin(angle))


@checked
class Animation(Checked):
    """A clip: channels for the nodes of a rig. `duration` is the time of the last key, in seconds.

    `apply` assigns to the objects that hang on the rig: transforms and visibility of instances, the poses of skins and
    morph targets, cameras and lights. Nodes without a channel are in their rest pose, so that clips don't mix.
    """

    rig: Rig
    channels: Sequence[Channel]
    name: str = ""

    _converters = {"rig": checks.instance_of(lambda: Rig), "channels": tuple, "name": checks.text}

    def _validate(self) -> None:
        for channel in self.channels:
            if not 0 <= channel.node < self.rig.count:
                raise SolariError(f"{self.describe()}: there is no node {channel.node} among {self.rig.count}")

    @property
    def duration(self) -> float:
        """The time of the last key, in seconds."""
        return max((channel.times[-1] for channel in self.channels), default=0.0)

    def apply(self, scene: Scene, seconds: float, *, loop: bool = True) -> None:
        """Pose a scene as it is some seconds after the start.

        loop: start again after the end; otherwise the end stays. Raises SolariError for a time that isn't finite, and
        for values that the objects can't take.
        """
        try:
            seconds = float(seconds)
        except (TypeError, ValueError):
            seconds = math.nan
        if not math.isfinite(seconds):
            raise SolariError(f"{self.describe()}: the time must be a finite number of seconds")
        duration = self.duration
        if loop and duration > 0:
            seconds %= duration
        try:
            samples = [(channel.node, channel.path, channel.at(seconds)) for channel in self.channels]
            self.rig.pose(scene.lights, samples)
        except SolariError as error:
            raise SolariError(f"{self.describe()} at {seconds:g} s: {error}") from None

