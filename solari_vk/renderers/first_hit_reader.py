"""Depth, normals, materials and instances of the surfaces that a camera sees: results beside the radiance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.projection import JITTERS, CameraUniforms, Projection
from solari_vk.gpu.device.buffer import Buffer
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
        self._motion: Frame | None = None
        self._motion_built: tuple[Any, ...] = ()

    def read(self, name: str, projection: Projection, size: tuple[int, int], proxies: bool = True) -> NDArray[Any]:
        """One of first_hits.FIRST_HITS, (height, width[, channels])."""
        return reference.read_aov(self._frame_at(projection, size, (0.0, 0.0), proxies), name, size)

    def tensor(
        self, name: str, projection: Projection, size: tuple[int, int], proxies: bool = True
    ) -> NDArray[Any] | CudaTensor:
        """What `read` returns, as a tensor that stays on the device; see `RenderedFrame.tensor`."""
        values = self._frame_at(projection, size, (0.0, 0.0), proxies).tensor(f"aov_{name}")
        return values.reshape(size[1], size[0], *values.shape[1:])

    def motion(
        self,
        projections: tuple[Projection, Projection],
        sizes: tuple[tuple[int, int], tuple[int, int]],
        instances: Buffer,
        proxies: bool,
    ) -> Frame:
        """A frame whose buffer `aov_motion_vectors` has the motion at the centers of the rendered pixels.

        projections: the frame's, and that of the frame before. sizes: of the picture, and of what is rendered.
        instances: the transforms of the frame before.
        """
        size, rendered = sizes
        rows = reference.max_rows(rendered)
        built = self._build_key(rendered, proxies)
        if self._motion is None or built != self._motion_built:
            if self._motion is not None:
                self._motion.close()
            self._motion = self._made(rendered, rows, built[-1], {"previous_instances": instances})
            self._motion_built = built
        frame = self._motion
        frame.bind({"previous_instances": instances})
        camera = CameraUniforms(frame.uniforms, self._binder.origin)
        camera.write_projection(projections[1], size, render_size=rendered)
        camera.write_projection(projections[0], size, render_size=rendered, has_history=True)
        self._submit(frame, rendered, rows)
        return frame

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
        built = self._build_key(size, proxies)
        if self._frame is None or built != self._built:
            self.close()
            self._frame = self._made(size, rows, built[-1])
            self._built = built
        # All outputs of a view are computed together, and read one by one.
        view = self._binder.scene_revision, projection.view, offset
        if view != self._computed_for:
            CameraUniforms(self._frame.uniforms, self._binder.origin).write_projection(projection, size, offset)
            self._submit(self._frame, size, rows)
            self._computed_for = view
        return self._frame

    def _build_key(self, size: tuple[int, int], proxies: bool) -> tuple[Any, ...]:
        # Raster is needed where instances have a mesh for rays that isn't the one that pictures show.
        rasters = not proxies and gbuffer.PROXIES in self._binder.features
        return self._binder.bindings_version, self._binder.instance_capacity, size, rasters

    def _made(self, size: tuple[int, int], rows: int, rasters: bool, motion: Mapping[str, Any] | None = None) -> Frame:
        """A frame that finds the surfaces; with what motion needs beside the scene, their motion."""
        external = {**self._binder.resources, **self._lookup_tables, **(motion or {})}
        stages = [reference.aov_stage(size, rows, "raster_aov" if rasters else "aov", motion is not None)]
        if rasters:
            stages.insert(0, gbuffer.raster_stage(size, self._binder.instance_capacity))
        return Frame(self._device, stages, external=external, features=self._binder.features)

    def _submit(self, frame: Frame, size: tuple[int, int], rows: int) -> None:
        frame.uniforms["path_sampling.row_count"] = rows
        for row in range(0, size[1], rows):
            frame.uniforms["path_sampling.first_row"] = row
            frame.submit()

    def close(self) -> None:
        """Free all memory on the device; the next `read` allocates it again."""
        for frame in (self._frame, self._motion):
            if frame is not None:
                frame.close()
        self._frame = self._motion = None
        self._computed_for = ()


def _hammersley() -> list[tuple[float, float]]:
    """COVERAGE_RAYS points, evenly over a pixel, as offsets from its center."""
    # The second coordinate is the number with its binary digits in reverse: Hammersley, "Monte Carlo Methods for
    # Solving Multivariable Problems" (1960). Half a step moves the points from the edges of their cells to the middle.
    reversed_digits = [int(f"{number:0{COVERAGE_BITS}b}"[::-1], 2) for number in range(COVERAGE_RAYS)]
    points = [((x + 0.5) / COVERAGE_RAYS, (y + 0.5) / COVERAGE_RAYS) for x, y in enumerate(reversed_digits)]
    return [(x - 0.5, y - 0.5) for x, y in points]
