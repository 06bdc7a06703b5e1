"""The records of a batch's views for shaders with MANY_VIEWS: struct View of glsl/scene/camera_records.glsl.

They are in the device's memory alone. Just before each frame glsl/scene/tensors/views.comp makes the next ones from
three things: what the host uploads for each frame, what it uploads only when that changes, and the records of the frame
before, whose cameras become the previous ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from operator import is_
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.batch.view_cameras import MATRIX_NUMBERS, ViewCameras
from solari_vk.bound.projection import SEED_STRIDE, lens_point
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import full_barrier
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.mirror import Mirror
from solari_vk.gpu.frame.kernel import Kernel
from solari_vk.gpu.shaders.spirv import Binding
from solari_vk.gpu.tensors.imports import DeviceTensor
from solari_vk.gpu.tensors.port import POSE_RULE, Dispatch, TensorPort, rule

# What all views share: the fields of FrameOfViews in glsl/scene/tensors/view_records.glsl before its rows.
SHARED = np.dtype(
    [("columns", "u4"), ("cache_partitions", "u4"), ("has_own_lights", "u4"), ("index", "u4"), ("matrices", "u8")]
)
_WORLD = [("world", "u4"), ("first_instance", "u4")]
# The rows that follow, each with a number of every view: the matrices, 4 offsets, and whether the view is reset.
_OFFSETS = MATRIX_NUMBERS
_RESET = MATRIX_NUMBERS + 4
_ROWS = MATRIX_NUMBERS + 5


class ViewBuffer:
    """The records of a batch's views on the device, for one of its frames. columns: of the grid of their pictures.
    cache_partitions: of the world cache, which wants the ball around the cameras; 0 without one."""

    def __init__(
        self,
        device: Device,
        port: TensorPort,
        views_binding: Binding,
        count: int,
        columns: int = 1,
        cache_partitions: int = 0,
    ) -> None:
        assert views_binding.element is not None
        self._device = device
        self._count = count
        self._begin = views_binding.element_offset
        self._first = True  # no frame has been shown
        self._written = False  # `records` were, or must be, since the latest upload
        self._seen: tuple[tuple[Any, ...], tuple[Any, ...]] = (), ()  # what the records were made from
        self._port = port
        self._tensor_rows: Buffer | None = None  # of tensors, as rows
        fields = views_binding.element.fields
        assert fields is not None
        inputs = [("camera", fields["current"][0]), ("frame", fields["frame"][0]), *_WORLD]
        self.records = np.zeros(count, inputs)
        """ViewInput of view_records.glsl (N,): what changes seldom. Write to it where `must_write`."""
        self._cameras: NDArray[Any] | None = None  # that were written
        # The memory of their records, in which numpy copies them ten times as fast as by their fields.
        self._bytes = self.records.view(np.uint8).reshape(count, -1)[:, : fields["current"][0].itemsize]
        memory = np.zeros(SHARED.itemsize + 4 * _ROWS * count, np.uint8)
        self.shared = memory[: SHARED.itemsize].view(SHARED)
        """What all views share (1,)."""
        rows = memory[SHARED.itemsize :].view(np.float32).reshape(_ROWS, count)
        self._rows = rows[:MATRIX_NUMBERS]
        self._reset = rows[_RESET]
        self.offsets = rows[_OFFSETS:_RESET].reshape(2, 2, count)
        """Camera.jitter and FrameValues.sample_jitter by x and y (2, 2, N), kept from frame to frame."""
        self.shared["columns"] = columns
        self.shared["cache_partitions"] = cache_partitions
        with device.undone_on_error():
            self.buffer = device.buffer(self._begin + count * views_binding.element.itemsize, "views")
            self.buffer.fill()
            self._steps = [(Kernel(device, "scene/tensors/views.comp"), count)]
            if cache_partitions:
                self._steps.append((Kernel(device, "scene/tensors/views_ball.comp"), 1))
            self._inputs = Mirror(device, self.records.view(np.uint8), "rare changes of views")
            self._frame = Mirror(device, memory, "frame of views", self._record)

    def _record(self, commands: raw.CData) -> None:
        # After the upload of `_frame`, in the same submission as the frame that reads the records.
        block = self.buffer.address
        for kernel, threads in self._steps:
            kernel.record(
                commands,
                (threads, 1),
                block=block,
                views=block + self._begin,
                inputs=self._inputs.buffer.address,
                frame=self._frame.buffer.address,
                count=self._count,
            )
            self._device.vk.vkCmdPipelineBarrier2(commands, full_barrier())

    def must_write(self, sources: tuple[Any, ...], values: tuple[Any, ...]) -> bool:
        """Whether `records` must be written before the next frame: where a source is another object than in the call
        before, or a value isn't equal. Remembers both for the next call."""
        # Arrays that may change are compared by identity, since comparing their numbers takes as long as writing them.
        old_sources, old_values = self._seen
        are_same = len(old_sources) == len(sources) and all(map(is_, old_sources, sources))
        self._written |= not are_same or old_values != values
        self._seen = sources, values
        return self._written

    def write_cameras(self, cameras: ViewCameras, samples: Mapping[str, Any] | None = None) -> None:
        """Write the records of cameras, with the fields that samples change, such as `sample_fields` returns, and
        with their own jitter."""
        now = self.records["camera"]
        if cameras.records is not self._cameras:
            self._bytes[:] = cameras.records.view(np.uint8).reshape(self._bytes.shape)
            self.offsets[0] = cameras.records["jitter"].T
            self._cameras = cameras.records
        for name, values in (samples or {}).items():
            now[name] = values

    def upload_frame(self, cameras: ViewCameras, reset: NDArray[np.bool_], index: int = 0) -> None:
        """Have the next submission make the records of a frame with this index. Those so far become the previous
        cameras, but for views that are reset, (N,) or one for all."""
        matrices = cameras.matrices
        address = self._frame.buffer.address + SHARED.itemsize
        if isinstance(matrices, DeviceTensor):
            if self._tensor_rows is None:
                self._tensor_rows = self._device.buffer(4 * MATRIX_NUMBERS * self._count, "cameras of tensors")
            address = self._tensor_rows.address
            self._write_tensor(matrices, address, cameras.origins[0])
        else:
            self._rows[:] = matrices
        # The first frame has no records before, whose cameras could be the previous ones.
        self._reset[:] = True if self._first else reset
        self.shared["index"] = index
        self.shared["matrices"] = address
        if self._written:
            self._inputs.upload()
        self._frame.upload()
        self._first = self._written = False

    def _write_tensor(self, transforms: DeviceTensor, rows: int, origin: NDArray[np.float64]) -> None:
        """Have the 24 numbers of the matrices of each camera written, each as a row for all cameras, at an address."""
        field = "Batch.render: the pose"
        pushed = {
            **self._port.matrices(transforms, self._count, origin),
            **self._port.refusal(field, rule(field, "view", POSE_RULE)),
            "first": rows,
        }
        self._port.write([Dispatch("cameras", (self._count, 1), pushed)], "cameras", with_next=True)

    def destroy(self) -> None:
        for owned in (
            self._frame,
            self._inputs,
            *(kernel for kernel, _ in self._steps),
            self.buffer,
            self._tensor_rows,
        ):
            if owned is not None:
                owned.destroy()


def sample_fields(
    cameras: ViewCameras, size: tuple[int, int], render_size: tuple[int, int], frame: int, seeds: NDArray[np.uint32]
) -> dict[str, Any]:
    """The fields of records (N,) of what is rendered for pictures of this size, and of apertures whose points are those
    of a frame with these seeds (N,)."""
    samples = {"size": render_size, "principal_shift": cameras.principal_shift * np.divide(render_size, size)}
    if cameras.apertures:
        points = np.zeros_like(cameras.principal_shift)
        for index, camera in cameras.apertures.items():
            points[index] = lens_point(camera, frame + SEED_STRIDE * int(seeds[index]))
        samples["lens_offset"] = points
    return samples
