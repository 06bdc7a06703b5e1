"""Animations: clips of keyframes for a rig, the times at which they are played, and mixes of clips."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Protocol

from solari_vk.base.errors import SolariError, quoted
from solari_vk.scene import checks
from solari_vk.scene.animation.keyframes import Channel, Sample, tracks
from solari_vk.scene.animation.rig import Rig
from solari_vk.scene.collection import Items
from solari_vk.scene.lights.light import Light
from solari_vk.scene.observable import Checked, checked

ROUNDING = 1e-9  # of a clip's duration


class HasLights(Protocol):
    """A scene, of which clips need the lights: hidden ones leave it."""

    @property
    def lights(self) -> Items[Light]: ...


@checked
class Animation(Checked):
    """A clip: channels for the nodes of a rig. `duration` is the time of the last key, in seconds.

    `apply` assigns to the objects that hang on the rig: transforms and visibility of instances, the poses of skins and
    morph targets, cameras and lights. Nodes without a channel are in their rest pose. `mix` applies several clips.
    """

    rig: Rig
    channels: Sequence[Channel]
    name: str = ""

    _converters = {"rig": checks.instance_of(lambda: Rig), "channels": tuple, "name": checks.text}

    def _validate(self) -> None:
        for channel in self.channels:
            what = "property" if channel.path == "property" else "node"
            count = len(self.rig.properties) if what == "property" else self.rig.count
            if not 0 <= channel.node < count:
                raise SolariError(f"{self.describe()}: there is no {what} {channel.node} among {count}")
        # Sorted once for all the times at which the clip is played.
        object.__setattr__(self, "_tracks", tracks(self.channels))
        object.__setattr__(self, "_duration", max((channel.times[-1] for channel in self.channels), default=0.0))

    @property
    def duration(self) -> float:
        """The time of the last key, in seconds."""
        found: float = self._duration  # type: ignore[attr-defined]
        return found

    def apply(self, scene: HasLights, seconds: float, *, loop: bool = True) -> None:
        """Pose a scene as it is some seconds after the start.

        loop: start again after the end, which is shown itself; otherwise the end stays. Raises SolariError for a time
        that isn't finite, and for values that the objects can't take.
        """
        mix(scene, [(self, seconds, 1.0)], loop=loop)

    def samples(self, seconds: float, *, loop: bool = True) -> list[Sample]:
        """The values of all channels; arguments and errors are those of `apply`."""
        time = _number(seconds)
        if not math.isfinite(time):
            raise SolariError(f"{self.describe()}: the time must be a finite number of seconds, not {quoted(seconds)}")
        duration = self.duration
        if loop and duration > 0:
            # In clips without a duration there is nothing to repeat.
            repeated = time % duration
            # The end is shown where a pass ends, also by a sum of steps that rounding makes a little longer.
            tolerance = max(ROUNDING * duration, 4 * math.ulp(time))
            time = duration if time > 0 and repeated <= tolerance else repeated
        found: Any = self._tracks  # type: ignore[attr-defined]
        return [(track.nodes, track.path, track.at(time)) for track in found]


def mix(scene: HasLights, parts: Sequence[tuple[Animation, float, float]], *, loop: bool = True) -> None:
    """Pose a scene by clips at their times in seconds, by their weights, which are divided by their sum.

    Values are weighted means; rotations are normalized means of quaternions, and what is visible in at least half of
    the mix is visible. What a clip leaves alone is in its rest pose there. Raises SolariError for clips of different
    rigs, weights that are negative or not finite or all 0, and as `Animation.apply`.
    """
    clips = [clip for clip, _, _ in parts]
    shares = _shares([_number(weight) for _, _, weight in parts])
    if any(clip.rig is not clips[0].rig for clip in clips):
        raise SolariError("only animations of one rig can be mixed, such as those of one file")
    # All are sampled before the scene changes, so that an error leaves it as it was.
    samples = [clip.samples(seconds, loop=loop) for clip, seconds, _ in parts]
    try:
        clips[0].rig.pose(scene.lights, [part for part in zip(shares, samples, strict=True) if part[0] > 0])
    except SolariError as error:
        at = " with ".join(f"{clip.describe()} at {_number(seconds):g} s" for clip, seconds, _ in parts)
        raise SolariError(f"{at}: {error}") from None


def _shares(weights: Sequence[float]) -> list[float]:
    """Weights divided by their sum."""
    # NaN fails both conditions.
    if not all(weight >= 0 for weight in weights) or not 0 < sum(weights) < math.inf:
        raise SolariError("a mix of animations needs weights from 0 on, of which one is more than 0")
    return [weight / sum(weights) for weight in weights]


def _number(value: Any) -> float:
    """A number, NaN for what is none."""
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return math.nan
