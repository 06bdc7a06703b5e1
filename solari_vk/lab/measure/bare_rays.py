"""Kernels that only trace rays, as baselines for the renderers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.projection import CameraUniforms
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Pass, Stage
from solari_vk.lab.measure.figures import device_seconds
from solari_vk.renderers.scene_frame import SceneFrame
from solari_vk.scene.model import Camera

BOUNCES = 4


class BarePaths:
    """The path tracer's paths without shading (glsl/passes/bare_rays/paths.comp). A context manager.

    `frame`: each submit traces the paths of the latest `run` again.
    """

    def __init__(self, device: Device, binder: SceneBinder, camera: Camera, size: tuple[int, int]) -> None:
        stage = Stage("bench", buffers={"ray_count": size[0] * size[1]}, passes=[Pass("bare_rays/paths", threads=size)])
        self.frame = SceneFrame(device, binder, [stage])
        CameraUniforms(self.frame.uniforms, binder.origin).write(camera, size)

    def run(self, sample_index: int, bounces: int = BOUNCES) -> tuple[float, int]:
        """Trace a path for each pixel; returns the seconds that it took and the number of rays."""
        self.frame.uniforms["path_sampling.sample_index"] = sample_index
        self.frame.uniforms["path_sampling.max_bounces"] = bounces
        spent = device_seconds(self.frame.device, self.frame.submit)
        return spent, int(self.frame["ray_count"].sum(dtype=np.uint64))

    def __enter__(self) -> BarePaths:
        return self

    def __exit__(self, *_: object) -> None:
        self.frame.close()


@contextmanager
def plain_tracer(
    device: Device, binder: SceneBinder, origins: NDArray[np.float32], directions: NDArray[np.float32]
) -> Iterator[SceneFrame]:
    """A frame that traces rays, arrays of shape (N, 3), and writes the distance to the nearest hit of each to
    "plain_distances" (glsl/passes/bare_rays/trace.comp)."""
    rays = {"plain_origins": origins, "plain_directions": directions}
    buffers = {name: device.buffer(values.nbytes, name) for name, values in rays.items()}
    for name, values in rays.items():
        buffers[name].upload(values)
    count = len(origins)
    stage = Stage("plain", buffers={"plain_distances": count}, passes=[Pass("bare_rays/trace", threads=count)])
    with SceneFrame(device, binder, [stage], external=buffers) as frame:
        yield frame
    # The frame is closed before its buffers are destroyed.
    for buffer in buffers.values():
        buffer.destroy()
