"""The camera as the shaders' uniforms hold it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.gpu.uniforms import Uniforms
from solari_vk.scene.model import Camera


@dataclass(frozen=True, eq=False)
class View:
    """A camera over a picture of a size in pixels."""

    key: tuple[Any, ...]
    world_from_view: NDArray[np.float32]  # (4, 3), by columns
    view_from_world: NDArray[np.float32]
    tan_half_fov: tuple[float, float]
    near: float

    @classmethod
    def of(cls, camera: Camera, size: tuple[int, int], known: View | None = None) -> View:
        """The camera as it is now; `known` itself if nothing differs from it."""
        key = camera.transform.tobytes(), camera.vertical_fov, camera.near, size
        if known is not None and known.key == key:
            return known
        tan_half_fov = math.tan(camera.vertical_fov / 2)
        placed = camera.transform.copy()
        placed[:3, :3] /= np.linalg.norm(placed[:3, :3], axis=0)  # or depths would be in the camera's own units
        return cls(
            key,
            placed[:3].T.astype(np.float32),
            np.linalg.inv(placed)[:3].T.astype(np.float32),
            (tan_half_fov * size[0] / size[1], tan_half_fov),
            camera.near,
        )

    def write(self, uniforms: Uniforms, prefix: str = "") -> None:
        """Set the uniforms of that prefix."""
        for name in ("world_from_view", "view_from_world", "tan_half_fov", "near"):
            uniforms[prefix + name] = getattr(self, name)


def write_view(uniforms: Uniforms, camera: Camera, size: tuple[int, int], rows: int) -> None:
    """What every pass that starts at pixels needs: the camera, the picture's size, and the rows of a dispatch."""
    View.of(camera, size).write(uniforms)
    uniforms["size"] = size
    uniforms["jitter"] = camera.jitter
    uniforms["row_count"] = rows
