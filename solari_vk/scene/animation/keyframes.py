"""Keyframes of the properties of a rig's nodes, as in glTF, and their values at a time."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, checked_constructor

Values = NDArray[np.float64]
Sample = tuple[NDArray[np.int64], str, Values]
"""Nodes (N,), which of their properties, and the values (N, C)."""
INTERPOLATIONS = ("LINEAR", "STEP", "CUBICSPLINE")
WIDTHS = {"translation": 3, "rotation": 4, "scale": 3, "visible": 1, "weights": None, "property": None}
"""What a channel changes, and how many numbers a key has: a mesh has any number of morph targets."""


@checked_constructor
@dataclass(frozen=True)
class Channel:
    """The keys of one property of a rig's node. Raises SolariError for keys that can't be played.

    times (K,): in seconds, ascending. values (K, C): translations in meters, unit quaternions (x, y, z, w), scales,
    visibility (more than 0), the weights of morph targets, or a property of a material, camera or light. For
    CUBICSPLINE (K, 3, C): each key's incoming tangent, value and outgoing tangent, tangents per second. node: for
    properties their number in the rig.
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
        self._check_shape(len(times), values.shape)
        finite = np.isfinite(times).all() and np.isfinite(values).all()
        if not (finite and times[0] >= 0 and (np.diff(times) >= 0).all()):
            raise SolariError(f"the {self.path} of an animation has keys that aren't finite or whose times descend")
        object.__setattr__(self, "times", times.tolist())
        object.__setattr__(self, "values", values)

    def _check_shape(self, key_count: int, values_shape: tuple[int, ...]) -> None:
        shape = (key_count, 3) if self.interpolation == "CUBICSPLINE" else (key_count,)
        width = WIDTHS[self.path]
        if values_shape[:-1] != shape or (width is not None and values_shape[-1] != width):
            wanted = ", ".join(map(str, (*shape, "C" if width is None else width)))
            raise SolariError(f"the {self.path} of an animation has values {values_shape}, but must have ({wanted})")

    def at(self, seconds: float) -> Values:
        """The value (C,) at a time; before the first key that of the first, after the last key that of the last."""
        found: Values = Track([self]).at(seconds)[0]
        return found


class Track:
    """Channels of the same path, interpolation and width. One call for all costs about as much as a call for one."""

    def __init__(self, channels: Sequence[Channel]) -> None:
        self.nodes = np.array([channel.node for channel in channels])
        self.path = channels[0].path
        self._interpolation = channels[0].interpolation
        times = [tuple(channel.times) for channel in channels]
        # The place in each list of times is found once, not for each channel.
        different = dict.fromkeys(times)  # in most files many channels have the same times
        self._times = list(different)
        numbers = {known: number for number, known in enumerate(different)}
        self._times_of = np.array([numbers[known] for known in times])
        self._starts = np.cumsum([0] + [len(known) for known in times[:-1]])
        self._keys = np.concatenate([channel.values for channel in channels])

    def at(self, seconds: float) -> Values:
        """The values (N, C) at a time."""
        found = [self._place_in(times, seconds) for times in self._times]
        places = np.array(found)[self._times_of]
        steps = places[:, :2].astype(np.int64)
        spans = places[:, 2:3]
        t = places[:, 3:]
        rows = self._starts + steps[:, 0]
        nexts = rows + steps[:, 1]
        if self._interpolation == "CUBICSPLINE":
            return self._fit(self._hermite(rows, nexts, spans, t))
        before, after = self._keys[rows], self._keys[nexts]
        if self.path == "rotation":
            return slerp(before, after, t)
        between: Values = (1 - t) * before + t * after
        return between

    def _place_in(self, times: Sequence[float], seconds: float) -> tuple[int, int, float, float]:
        """The key before a time, how many keys later the next one is (0 where a value stays), the time between both,
        and the share of it that has passed."""
        index = max(bisect_right(times, seconds) - 1, 0)
        is_constant = index == len(times) - 1 or seconds <= times[index] or self._interpolation == "STEP"
        if is_constant:
            return index, 0, 1.0, 0.0
        span = times[index + 1] - times[index]
        return index, 1, span, (seconds - times[index]) / span

    def _hermite(self, rows: NDArray[np.int64], nexts: NDArray[np.int64], spans: Values, t: Values) -> Values:
        # glTF 2.0, appendix C.5: a Hermite spline whose tangents are per second, so that they count times the span.
        before, after = self._keys[rows, 1], self._keys[nexts, 1]
        leaving, arriving = self._keys[rows, 2], self._keys[nexts, 0]
        rest = 1 - t
        value: Values = (1 + 2 * t) * rest**2 * before + t**2 * (3 - 2 * t) * after
        value += spans * t * rest * (rest * leaving - t * arriving)
        return value

    def _fit(self, values: Values) -> Values:
        return unit_quaternions(values) if self.path == "rotation" else values


def tracks(channels: Iterable[Channel]) -> list[Track]:
    """All channels, with those together that can be; later channels of a node's property are in later tracks."""
    groups: dict[tuple[str, str, int, int], list[Channel]] = {}
    seen: dict[tuple[int, str], int] = {}
    for channel in channels:
        target = channel.node, channel.path
        # Channels of one target must be applied in their order, so that the last counts.
        seen[target] = seen.get(target, -1) + 1
        key = channel.path, channel.interpolation, channel.values.shape[-1], seen[target]
        groups.setdefault(key, []).append(channel)
    # Tracks are applied in this order.
    return [Track(group) for _, group in sorted(groups.items(), key=lambda item: item[0][3])]


def unit_quaternions(values: Values) -> Values:
    """Quaternions (N, 4) with their lengths made 1; no rotation for one of zero length."""
    lengths = np.sqrt((values * values).sum(axis=1, keepdims=True))
    found: Values = np.where(lengths > 0, values / np.where(lengths > 0, lengths, 1), (0.0, 0.0, 0.0, 1.0))
    return found


def slerp(a: Values, b: Values, t: Values) -> Values:
    """Quaternions (N, 4) interpolated along the shorter arcs by t (N, 1), at constant speed: Shoemake, "Animating
    Rotation with Quaternion Curves" (1985)."""
    a, b = unit_quaternions(a), unit_quaternions(b)
    # A quaternion and its negative are the same rotation: the sign that makes the angle smaller is the shorter arc.
    cosine = (a * b).sum(axis=1, keepdims=True)
    angle = np.arccos(np.minimum(np.abs(cosine), 1.0))
    sine = np.sin(angle)
    near = angle < 1e-6  # where the sines' ratio has no digits left, the interpolation is linear
    sine[near] = 1.0
    first = np.where(near, 1 - t, np.sin((1 - t) * angle) / sine)
    second = np.where(near, t, np.sin(t * angle) / sine)
    return unit_quaternions(first * a + np.where(cosine < 0, -second, second) * b)
