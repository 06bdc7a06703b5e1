"""Several cameras on one body: stereo pairs, the six faces of a cube, and rigs of robots and cars."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from solari_vk.base.errors import Hints, SolariError, checked_constructor, quoted
from solari_vk.scene.camera import Camera
from solari_vk.scene.placement import placed

FACES = {
    "+x": ((1, 0, 0), (0, 1, 0)),
    "-x": ((-1, 0, 0), (0, 1, 0)),
    "+y": ((0, 1, 0), (0, 0, 1)),
    "-y": ((0, -1, 0), (0, 0, -1)),
    "+z": ((0, 0, 1), (0, 1, 0)),
    "-z": ((0, 0, -1), (0, 1, 0)),
}
"""Where the faces of a cube look, and what is up in their pictures."""


@checked_constructor
class CameraRig(Hints):
    """Cameras whose poses are relative to a body, which looks along its -z axis with y up, as cameras do.

    cameras: by name; their transforms are body from camera. `rig.at(transform)` are the cameras in the world, in this
    order: `batch.render(rig.at(transform))` renders all of them in one call. Raises SolariError without cameras.
    """

    def __init__(self, cameras: Mapping[str, Camera]) -> None:
        if not isinstance(cameras, Mapping) or not all(isinstance(one, Camera) for one in cameras.values()):
            raise SolariError(f"CameraRig: give cameras by name, not {quoted(cameras)}")
        if not cameras:
            raise SolariError("CameraRig: give at least one camera")
        self.cameras = dict(cameras)
        """By name, with their poses on the body."""

    @classmethod
    def stereo(cls, camera: Camera, baseline: float) -> CameraRig:
        """A "left" and a "right" camera like this one, half of `baseline` meters to each side of it.

        The camera's pose is that on the body, so that `at()` without a pose is about the camera. Cameras may have any
        projection: two panoramas are stereo before and behind the body, and not at its sides.
        """
        shift = np.eye(4)
        # Both move along the camera's own x axis, so that they stay parallel.
        pair = dict[str, Camera]()
        for name, side in (("left", -1), ("right", 1)):
            shift[0, 3] = side * baseline / 2
            pair[name] = _copy(camera, camera.transform @ shift)
        return cls(pair)

    @classmethod
    def omnidirectional(cls, baseline: float, **fields: Any) -> CameraRig:
        """A "left" and a "right" panorama whose eyes stay `baseline` meters apart across every direction in which they
        look, about the vertical axis of the body: omnidirectional stereo, as headsets show it. fields: further ones of
        Camera. Ishiguro, Yamamoto and Tsuji, "Omni-Directional Stereo" (1992)."""
        return cls(
            {
                name: Camera(projection="equirectangular", eye_offset=side * baseline / 2, **fields)
                for name, side in (("left", -1), ("right", 1))
            }
        )

    @classmethod
    def cube(cls, **fields: Any) -> CameraRig:
        """Six cameras of 90 degrees for square pictures, by the axes along which they look: FACES says what is up.

        Each picture is what a camera sees; cube maps of OpenGL and Vulkan mirror it. fields: further ones of Camera.
        """
        # A face of a cube; fields may say otherwise, for an overlap.
        options = {"fov": 90, **fields}
        return cls({name: Camera.look_at((0, 0, 0), along, up, **options) for name, (along, up) in FACES.items()})

    def at(
        self,
        transform: ArrayLike | None = None,
        *,
        position: ArrayLike | None = None,
        rotation: ArrayLike | None = None,
    ) -> list[Camera]:
        """The cameras in the world, where the body is. Arguments are those of a Camera; by default the origin."""
        body = placed(transform, "CameraRig", position=position, rotation=rotation)
        return [_copy(camera, body @ camera.transform) for camera in self.cameras.values()]

    def __len__(self) -> int:
        return len(self.cameras)


def _copy(camera: Camera, transform: Any) -> Camera:
    fields = {name: getattr(camera, name) for name in type(camera)._names}
    return Camera(**fields | {"transform": transform})
