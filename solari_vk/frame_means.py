"""Means over the frames of the realtime renderer."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.renderer import LIGHT, Renderer


class FrameMeans:
    """Radiance and its parts as means of frames, taken in float64; other results are the latest frame's.

    names: results beside the radiance.
    """

    def __init__(self, renderer: Renderer, names: Iterable[str] = ()) -> None:
        self._renderer = renderer
        self._sums: dict[str, Any] = dict.fromkeys(["radiance", *(name for name in names if name in LIGHT)], 0.0)
        self.count = 0
        """The number of frames."""

    def add(self) -> None:
        """Take the renderer's latest frame."""
        for name in self._sums:
            self._sums[name] = self._sums[name] + self._renderer[name].astype("float64")
        self.count += 1

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name in self._sums:
            return np.asarray(self._sums[name] / self.count, np.float32)
        values = self._renderer[name]
        return values / 255.0 if values.dtype == np.uint8 else values
