"""Means over the frames of the realtime renderer."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.output.error import ErrorEstimate, area_means
from solari_vk.renderers.renderer import RADIANCE_COMPONENTS, Renderer


class FrameAccumulator:
    """Radiance and its parts as means of frames, summed in float64 and returned in float32; other results are the
    latest frame's.

    names: results beside the radiance. estimate: gets the means of what the paths gave, to estimate the mean's error at
    the size that is rendered. exposes: frames have a shutter, so that the `radiance` of the latest one is the mean of
    all frames already.
    """

    def __init__(
        self,
        renderer: Renderer,
        names: Iterable[str] = (),
        estimate: ErrorEstimate | None = None,
        *,
        exposes: bool = False,
    ) -> None:
        self._renderer = renderer
        self._estimate = estimate
        # What the paths gave, without the denoiser, whose errors are alike in all frames.
        self._raw = "raw_radiance" if "raw_radiance" in renderer.outputs else "radiance"
        summed = [name for name in names if name in RADIANCE_COMPONENTS]
        if not exposes:
            summed.append("radiance")
        if estimate is not None:
            summed.append(self._raw)
        self._sums: dict[str, Any] = dict.fromkeys(summed, 0.0)
        self.count = 0
        """The number of frames."""

    def add(self) -> None:
        """Add the renderer's latest frame."""
        for name in self._sums:
            # In float64, because the rounding of thousands of sums in float32 would show.
            self._sums[name] = self._sums[name] + self._renderer[name].astype("float64")
        self.count += 1
        if self._estimate is not None and self.count >= self._estimate.next_look:
            size = self._renderer.render_size
            mean = self._sums[self._raw] / self.count
            self._estimate.add_denoised(self.count, mean, lambda: area_means(self["radiance"], size))

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name in self._sums:
            return np.asarray(self._sums[name] / self.count, np.float32)
        values = self._renderer[name]
        return values / 255.0 if values.dtype == np.uint8 else values
