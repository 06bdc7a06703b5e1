"""The records of a batch's views for shaders with MANY_VIEWS: struct View of glsl/scene/camera_block.glsl."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.given_poses import KEPT_FLOATS, GivenPoses
from solari_vk.bound.projection import SEED_STRIDE, lens_point
from solari_vk.bound.view_cameras import Floats, Written
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.cuda_input import Taken
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.mirror import Mirror
from solari_vk.gpu.shaders.spirv import Binding


class ViewTable:
    """The records of a batch's views on the device, for one of its frames. columns: of the grid of their pictures.
    world_parts: of the world cache."""

    def __init__(self, device: Device, layout: Binding, count: int, columns: int = 1, world_parts: int = 1) -> None:
        assert layout.element is not None
        assert layout.dtype is not None
        self._begin = layout.element_offset
        self._memory = np.zeros(self._begin + count * layout.element.itemsize, np.uint8)
        self.shared = self._memory[: self._begin].view(layout.dtype)
        """What all views share (1,)."""
        self.records = self._memory[self._begin :].view(layout.element)
        self.shared["columns"], self.shared["world_parts"] = columns, world_parts
        self._device = device
        self._mirror = Mirror(device, self._memory, "views")
        self.buffer = self._mirror.buffer
        self._current, self._previous = (self._bytes_of(layout.element, name) for name in ("current", "previous"))
        self._shown: NDArray[Any] | None = None  # the records of the latest frame
        self.given_poses = GivenPoses(device, "Batch.render", "view")
        self._poses: Taken | None = None
        self._earlier: Buffer | None = None  # cameras of tensors, of the latest frame that had one
        self._had_tensor = False

    def _bytes_of(self, layout: np.dtype[Any], name: str) -> NDArray[np.uint8]:
        """The memory of a field (N, bytes), in which numpy copies it ten times as fast as by its fields."""
        assert layout.fields is not None
        dtype, begin = layout.fields[name][:2]
        rows = self.records.view(np.uint8).reshape(len(self.records), layout.itemsize)
        return rows[:, begin : begin + dtype.itemsize]

    def show(self, cameras: Written, cut: NDArray[np.bool_], samples: Mapping[str, Any] | None = None) -> None:
        """Make these the cameras of the next frame, and those so far the previous ones, but for views that are cut.
        samples: fields that differ from those of `cameras.records`, such as `samples_of` returns them."""
        first, poses, now = self._shown is None, cameras.poses, self.records["current"]
        self._had_tensor, self._poses = self._poses is not None, poses if isinstance(poses, Taken) else None
        self._previous[:] = self._current
        if cameras.records is not self._shown:
            self._shown = cameras.records
            self._current[:] = cameras.records.view(np.uint8).reshape(self._current.shape)
        if poses is not None:
            now["world_from_view"], now["view_from_world"] = (0, 0) if isinstance(poses, Taken) else poses
        for name, values in (samples or {}).items():
            now[name] = values
        if first:
            self._previous[:] = self._current
        elif cut.any():
            self._previous[cut] = self._current[cut]
        if self._poses is not None:  # tells cameras.comp, when this is the previous camera, that it was a tensor's
            now["world_from_view"][:, 0, 0] = 1

    def upload(self, *, ball: bool = False) -> None:
        """Have the device see the records, in the next submission. ball: with the one around the cameras."""
        if ball and self._poses is None:
            self._find_ball()
        self._mirror.upload()
        if self._poses is None and not self._had_tensor:
            return
        count, layout, shared = len(self.records), self.records.dtype.fields, self.shared.dtype.fields
        assert layout is not None
        assert shared is not None
        if self._earlier is None:
            self._earlier = self._device.buffer(4 * KEPT_FLOATS * count, "cameras of tensors")
        (camera, begin), previous = layout["current"][:2], layout["previous"][1]
        assert camera.fields is not None
        place = self._begin + begin + camera.fields["world_from_view"][1]
        self.given_poses.write(
            self._poses, "the pose", count, (self.buffer.address, place // 4, self.records.itemsize // 4),
            (self._earlier.address, 0, KEPT_FLOATS), "cameras", (previous - begin) // 4,
            self.buffer.address + shared["ball_center"][1] if ball and self._poses is not None else 0,
        )  # fmt: skip

    def _find_ball(self) -> None:
        places = np.array(self.records["current"]["world_from_view"][:, 3].T, np.float64, order="C")
        center = ((places.min(axis=1) + places.max(axis=1)) / 2).astype(np.float32)
        away = places - center[:, None]
        self.shared["ball_center"] = center
        self.shared["ball_radius"] = math.sqrt((away * away).sum(axis=0).max())

    def destroy(self) -> None:
        """Free everything."""
        self.given_poses.destroy()
        self._mirror.destroy()
        if self._earlier is not None:
            self._earlier.destroy()


def samples_of(
    written: Written, size: tuple[int, int], render_size: tuple[int, int], offsets: Floats, frame: int,
    seeds: NDArray[np.uint32],
) -> dict[str, Any]:  # fmt: skip
    """The fields of records (N,) whose samples are moved by offsets (N, 2) in pixels of what is rendered for pictures
    of this size, and to the points of apertures of a frame with these seeds (N,). `Renderer` does the same for one
    camera."""
    scale = np.divide(render_size, size)
    shift = written.principal_shift * scale
    samples = {"size": render_size, "jitter": written.jitter * scale + offsets + shift, "principal_shift": shift}
    if written.apertures:
        samples["lens_offset"] = points = np.zeros_like(shift)
        for index, camera in written.apertures.items():
            points[index] = lens_point(camera, frame + SEED_STRIDE * int(seeds[index]))
    return samples
