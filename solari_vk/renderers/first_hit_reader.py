"""Depth, normals, materials and instances of the surfaces that a camera sees: results beside the radiance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.projection import JITTERS, CameraUniforms, Projection
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Frame
from solari_vk.gpu.tensors.exports import CudaTensor
from solari_vk.passes import gbuffer, reference

AVERAGED = 16  # rays of a pixel in a mean
COVERAGE_BITS = 6
COVERAGE_RAYS = 1 << COVERAGE_BITS
"""The rays by which the alpha of a pixel is found, at Hammersley's points. With only 16 of them, a bright background
would show in the edges of what is cut out."""


class FirstHitReader:
    """Finds the surface at each pixel's center, on demand: by a ray, or by raster where the picture shows meshes that
    rays don't hit.

    The results show the scene as the binder holds it when they are computed. `proxies` says whether instances show
    their ray_mesh where they have one.
    """

    def __init__(self, device: Device, binder: SceneBinder, tables: Mapping[str, Any]) -> None:
        # The frame is made when a result is first asked for: many renderers are never asked for one.
        self._device = device
        self._binder = binder
        self._lookup_tables = tables
        self._frame: Frame | None = None
        self._built: tuple[Any, ...] = ()  # what the frame was built for
        self._computed_for: tuple[Any, ...] = ()  # the binder's revision and the camera that its buffers show

    def read(self, name: str, projection: Projection, size: tuple[int, int], proxies: bool = True) -> NDArray[Any]:
        """One of first_hits.FIRST_HITS, (height, width[, channels])."""
        return reference.read_aov(self._frame_at(projection, size, (0.0, 0.0), proxies), name, size)

    def tensor(
        self, name: str, projection: Projection, size: tuple[int, int], proxies: bool = True
    ) -> NDArray[Any] | CudaTensor:
        """What `read` returns, as a tensor that stays on the device; see `RenderedFrame.tensor`."""
        values = self._frame_at(projection, size, (0.0, 0.0), proxies).tensor(f"aov_{name}")
        return values.reshape(size[1], size[0], *values.shape[1:])

    def read_means(self, names: Sequence[str], projection: Projection, size: tuple[int, int]) -> list[NDArray[Any]]:
        """Means over the area of each pixel, (height, width[, channels]) each, with proxies."""
        means: list[Any] = [0.0] * len(names)
        for offset in JITTERS[:AVERAGED]:
            frame = self._frame_at(projection, size, offset, True)
            for index, name in enumerate(names):
                means[index] = means[index] + reference.read_aov(frame, name, size) / np.float32(AVERAGED)
        return means

    def read_at(
        self, names: Sequence[str], projection: Projection, size: tuple[int, int], offset: tuple[float, float]
    ) -> list[NDArray[Any]]:
        """The results at an offset from the pixels' centers, in pixels, with proxies."""
        frame = self._frame_at(projection, size, offset, True)
        return [reference.read_aov(frame, name, size) for name in names]

    def read_coverage(self, projection: Projection, size: tuple[int, int]) -> NDArray[np.float32]:
        """The share of each pixel (height, width) that shows a surface, from COVERAGE_RAYS rays, with proxies."""
        frames = (self._frame_at(projection, size, offset, True) for offset in _hammersley())
        hits = sum(np.isfinite(reference.read_aov(frame, "depth", size)).astype(np.float32) for frame in frames)
        return np.asarray(hits / COVERAGE_RAYS, np.float32)

    def _frame_at(
        self, projection: Projection, size: tuple[int, int], offset: tuple[float, float], proxies: bool
    ) -> Frame:
        """A frame whose buffers have the results at an offset from the pixels' centers, in pixels."""
        rows = reference.max_rows(size)
        # Raster is needed where instances have a mesh for rays that isn't the one that pictures show.
        rasters = not proxies and gbuffer.PROXIES in self._binder.features
        built = self._binder.bindings_version, self._binder.instance_capacity, size, rasters
        if self._frame is None or built != self._built:
            self.close()
            external = {**self._binder.resources, **self._lookup_tables}
            stages = [reference.aov_stage(size, rows, "raster_aov" if rasters else "aov")]
            if rasters:
                stages.insert(0, gbuffer.raster_stage(size, self._binder.instance_capacity))
            self._frame = Frame(self._device, stages, external=external, features=self._binder.features)
            self._built = built
        # All outputs of a view are computed together, and read one by one.
        view = self._binder.scene_revision, projection[1:], offset
        if view != self._computed_for:
            uniforms = self._frame.uniforms
            CameraUniforms(uniforms).write_projection(projection, size, offset)
            uniforms["path_sampling.row_count"] = rows
            for row in range(0, size[1], rows):
                uniforms["path_sampling.first_row"] = row
                self._frame.submit()
            self._computed_for = view
        return self._frame

    def close(self) -> None:
        """Free all memory on the device; the next `read` allocates it again."""
        if self._frame is not None:
            self._frame.close()
        self._frame = None
        self._computed_for = ()


def _hammersley() -> list[tuple[float, float]]:
    """COVERAGE_RAYS points, evenly over a pixel, as offsets from its center."""
    # The second coordinate is the number with its binary digits in reverse: Hammersley, "Monte Carlo Methods for
    # Solving Multivariable Problems" (1960). Half a step moves the points from the edges of their cells to the middle.
    reversed_digits = [int(f"{number:0{COVERAGE_BITS}b}"[::-1], 2) for number in range(COVERAGE_RAYS)]
    points = [((x + 0.5) / COVERAGE_RAYS, (y + 0.5) / COVERAGE_RAYS) for x, y in enumerate(reversed_digits)]
    return [(x - 0.5, y - 0.5) for x, y in points]
