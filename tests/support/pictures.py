"""Path-traced pictures with measured variances, and their comparison with what is expected."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.conformance.rules import Measurement, Rule
from solari_vk.gpu.device.device import Device
from solari_vk.reference import PathTracer
from solari_vk.scene.model import Camera, Scene
from support.statistics import compare


@dataclass
class Picture:
    """A picture as R independent parts of its samples, (R, h, w, 3)."""

    runs: NDArray[Any]

    @property
    def mean(self) -> NDArray[Any]:
        """The mean of the parts (h, w, 3), float64."""
        return self.runs.mean(axis=0, dtype=np.float64)  # type: ignore[no-any-return]

    @property
    def variance(self) -> NDArray[Any]:
        """The variance of the mean (h, w, 3)."""
        return self.runs.var(axis=0, ddof=1, dtype=np.float64) / len(self.runs)  # type: ignore[no-any-return]


def take_picture(
    device: Device, scene: Scene, size: tuple[int, int] = (48, 48), samples: int = 64, *,
    runs: int = 8, camera: Camera | None = None, **settings: Any,
) -> Picture:  # fmt: skip
    """Take a picture of `samples` per pixel in `runs` consecutive parts; settings are those of PathTracer.

    The variance comes from the spread of the parts, not from the renderer's own estimate.
    """
    with PathTracer(device, scene, size, **settings) as renderer:
        view = camera or scene.camera
        part = max(samples // runs, 1)
        sums = [np.zeros((size[1], size[0], 3))]
        for run in range(1, runs + 1):
            image = renderer.render(view, samples=run * part)["radiance"]
            assert image.shape == sums[0].shape
            assert image.dtype == np.float32
            assert np.isfinite(image).all()
            sums.append(image * np.float64(run * part))
        return Picture(np.diff(np.stack(sums), axis=0) / part)


def compare_picture(
    name: str, source: tuple[str, str], made: Picture, expected: ArrayLike, bar: float,
    variance: ArrayLike = 0.0, tile: int = 8,
) -> list[Measurement]:  # fmt: skip
    """Compare a picture with `expected` (h, w, 3): the mean within the bar, and each tile within statistical error."""
    found = compare(made.mean, made.variance, expected, variance, tile)
    mean, tiles = (Rule(f"{name}: {part}", *source) for part in ("mean", "tiles"))
    return [
        Measurement(mean, found.reach, bar, "relative error"),
        Measurement(tiles, found.max_z, found.z_bar, "standard errors"),
    ]
