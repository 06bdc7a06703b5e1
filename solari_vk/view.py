"""The camera as the shaders' uniforms hold it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solari_vk.gpu.uniforms import Uniforms
from solari_vk.scene.model import Camera


@dataclass(frozen=True, eq=False)
class View:
    """A camera over a picture of a size in pixels."""

    world_from_view: NDArray[np.float32]  # (4, 3), by columns
    view_from_world: NDArray[np.float32]
    tan_half_fov: tuple[float, float]
    near: float

    @classmethod
    def of(cls, camera: Camera, size: tuple[int, int]) -> View:
        """The camera as it is now."""
        tan_half_fov = math.tan(camera.vertical_fov / 2)
        return cls(
            camera.transform[:3].T.astype(np.float32),
            np.linalg.inv(camera.transform)[:3].T.astype(np.float32),
            (tan_half_fov * size[0] / size[1], tan_half_fov),
            camera.near,
        )


def write_view(uniforms: Uniforms, camera: Camera, size: tuple[int, int], rows: int) -> None:
    """What every pass that starts at pixels needs: the camera, the picture's size, and the rows of a dispatch."""
    view = View.of(camera, size)
    uniforms["world_from_view"] = view.world_from_view
    uniforms["tan_half_fov"] = view.tan_half_fov
    uniforms["near"] = view.near
    uniforms["size"] = size
    uniforms["jitter"] = camera.jitter
    uniforms["row_count"] = rows
