"""Exposure times: when a picture's samples are taken, and where the camera is meanwhile."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, checked_constructor, quoted
from solari_vk.scene.camera import Camera
from solari_vk.scene.matrices import rotation
from solari_vk.scene.quasirandom import GOLDEN_STEP, additive, radical_inverse

STILL = 1e-9  # radians
AT_ONCE = 1e-12  # seconds: of shorter readouts


class Moment(NamedTuple):
    """Samples of some rows at one time."""

    time: float
    rows: tuple[int, int]
    """The first row, and the one after the last."""
    samples: tuple[int, int]
    """The number of the first sample, and the one after the last."""


@checked_constructor
@dataclass(frozen=True, kw_only=True)
class Shutter:
    """When a picture is exposed: from `open` to `close`, in seconds.

    time_samples: times, one at random in each of as many equal parts, at which the scene is posed; the samples of a
    pixel are shared among them. Realtime frames show one time each. readout: seconds by which the last row is exposed
    later than the first (a rolling shutter), in row_bands steps; 0 exposes all rows at once (a global shutter). Raises
    SolariError for numbers out of range.
    """

    open: float = 0.0
    close: float
    readout: float = 0.0
    time_samples: int = 16
    row_bands: int = 32

    def __post_init__(self) -> None:
        for name in ("open", "close", "readout"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, float, np.number)) or not abs(float(value)) < 1e9:
                raise SolariError(f"Shutter: {name} is a number of seconds, not {quoted(value)}")
        if not self.open <= self.close:
            raise SolariError(f"Shutter: it must open, at {self.open:g} s, before it closes, at {self.close:g} s")
        for name in ("time_samples", "row_bands"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not 1 <= value <= 1 << 16:
                raise SolariError(f"Shutter: {name} is a whole number from 1 to 65,536, not {quoted(value)}")

    @property
    def middle(self) -> float:
        """The time at which the middle row's exposure is half over."""
        return (self.open + self.close + self.readout) / 2

    def at(self, seconds: float) -> Shutter:
        """The same exposure, some seconds later."""
        return dataclasses.replace(self, open=self.open + seconds, close=self.close + seconds)

    def moments(self, samples: int, height: int, seed: int) -> Iterator[Moment]:
        """When each row of a picture of this height is sampled, so that any number of first moments covers the time as
        evenly as it can: in the order of van der Corput's sequence."""
        times = min(self.time_samples, samples)
        bands = min(self.row_bands, height) if self.readout else 1
        # The ranks of the sequence's numbers are an order of all parts, in which each start of it is spread evenly.
        parts = np.argsort(np.argsort([radical_inverse(number, 2) for number in range(times)]))
        within = np.random.default_rng((seed, 0x5407)).uniform(size=(times, bands))
        for number, part in enumerate(parts.tolist()):
            shared = samples * number // times, samples * (number + 1) // times
            for band in range(bands):
                share = (part + float(within[number, band])) / times
                later = self.readout * (band + 0.5) / bands if self.readout else 0.0
                rows = height * band // bands, height * (band + 1) // bands
                yield Moment(self.open + share * (self.close - self.open) + later, rows, shared)

    def frame(self, number: int, height: int) -> tuple[float, tuple[int, int]]:
        """The time that a realtime frame shows, and the rows of a picture of this height whose exposure it is part of:
        the first one, and the one after the last.

        Times of successive numbers cover the exposures of all rows evenly. A rolling shutter exposes rows for
        `readout` / `row_bands` at least.
        """
        # Steps of the golden ratio: any number of successive times lies evenly.
        share = additive(number, GOLDEN_STEP)
        lasts = self.close - self.open
        if abs(self.readout) < AT_ONCE:
            return self.open + share * lasts, (0, height)
        # A realtime frame shows at least one band of rows, or a short exposure would be in no frame.
        longer = max(abs(self.readout) / min(self.row_bands, height) - lasts, 0.0)
        lasts += longer
        later = min(self.readout, 0.0) + share * (lasts + abs(self.readout))  # than the first row's exposure begins
        # The rows whose exposures contain the time, by the centers of rows; readouts may run upwards.
        first, last = sorted(height * (later - edge) / self.readout - 0.5 for edge in (0.0, lasts))
        rows = max(math.ceil(first), 0), max(min(math.floor(last) + 1, height), 0)
        return self.open - longer / 2 + later, rows


def between(first: Camera, second: Camera, share: float) -> Camera:
    """A camera on the way from one to another: its position and lens linearly, its rotation about one axis."""
    turn = first.rotation.T @ second.rotation
    axis = np.array((turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]))  # times 2 sin(angle)
    angle = float(np.arctan2(np.linalg.norm(axis), np.trace(turn) - 1))
    turned = first.rotation
    if angle > STILL:
        if angle > np.pi / 2:  # its sine goes to zero; the symmetric part has (1 - cosine) times the axis squared
            squared = (turn + turn.T) / 2 - np.cos(angle) * np.eye(3)
            largest = squared[np.argmax(np.diag(squared))]
            axis = largest * np.copysign(1, largest @ axis)
        turned = turned @ rotation(axis, share * angle)
    fields: dict[str, Any] = {name: getattr(first, name) for name in Camera._names}
    for name in ("vertical_fov", "orthographic_height", "aperture", "focus_distance"):
        fields[name] += share * (getattr(second, name) - fields[name])
    transform: NDArray[np.float64] = np.eye(4)
    transform[:3, :3] = turned
    transform[:3, 3] = first.position + share * (second.position - first.position)
    return Camera(**fields | {"transform": transform})
