"""Poses and transforms that tensors give on the device: shaders write them to the records that the host leaves open.

The host can't see what is wrong with them. A shader refuses a wrong one, and the first `check` that is called when the
device has got so far raises the error.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.errors import DeviceError, SolariError
from solari_vk.gpu.device import dlpack
from solari_vk.gpu.device.barriers import full_barrier, host_read_barrier
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.cuda_input import Taken
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.kernel import Kernel

MOST = (1 << 12) - 2  # things that messages tell apart
KEPT_FLOATS = 24  # of a camera: world_from_view and view_from_world
_RULE = "be finite, affine and invertible, and lie within 1e12"


def taken(device: Device, value: Any, what: str, *shapes: tuple[int, ...], where: str) -> Taken | None:
    """A tensor of one of these shapes in the device's memory. None for all that the host must read."""
    if isinstance(value, np.ndarray) or not hasattr(value, "__dlpack_device__"):
        return None
    if int(value.__dlpack_device__()[0]) not in (dlpack.CUDA, dlpack.ROCM) or "shaderFloat64" not in device.features:
        return None
    if tuple(value.shape) not in shapes:
        raise SolariError(f"{where}: {what} must have the shape {' or '.join(map(str, shapes))}, not "
                          f"{tuple(value.shape)}")  # fmt: skip
    try:
        return device.cuda_inputs.take(value)
    except DeviceError:
        if "cuda_inputs" in vars(device):
            raise
        return None  # CUDA doesn't share this device


class GivenPoses:
    """Writes matrices of tensors to records on the device. where: for messages."""

    def __init__(self, device: Device, where: str, of: str) -> None:
        self._device, self._where, self._of = device, where, of
        self._kernels: dict[str, Kernel] = {}
        self._wrong: Buffer | None = None  # in memory that the host sees
        self._what: list[str] = []

    def write(
        self, given: Taken | None, what: str, count: int, first: tuple[int, int, int], second: tuple[int, int, int],
        kernel: str = "transforms", previous: int = 0, ball: Buffer | None = None,
    ) -> None:  # fmt: skip
        """Have a kernel of glsl/scene/given write matrices (count, 4, 4) just before the next submission. first,
        second: where its records are: an address, and in floats the place and the step from one to the next. ball:
        gets the one around the first, which are cameras."""
        if self._wrong is None:
            self._wrong = self._device.buffer(16, "wrong tensors", host=True)
            self._wrong.write(np.zeros(4, np.uint32))
        if what not in self._what and len(self._what) >= MOST:
            what = "a matrix"
        if what not in self._what:
            self._what.append(what)
        source = {} if given is None else {
            "floats": given.address, "doubles": given.address, "is_double": given.dtype == np.float64,
            "step": given.strides[0] // given.dtype.itemsize,
        }  # fmt: skip
        pushed = {
            **source, "wrong": self._wrong.address, "count": count, "what": 1 + self._what.index(what),
            "first": first[0], "first_place": first[1], "first_step": first[2],
            "second": second[0], "second_place": second[1], "second_step": second[2],
            "previous": previous, "is_given": given is not None,
        }  # fmt: skip
        steps = [(self._kernel(kernel), count, pushed)]
        if ball is not None:
            steps.append((self._kernel("camera_ball"), 1, pushed | {"second": ball.address}))
        vk = self._device.vk

        def record(commands: Any) -> None:
            vk.vkCmdPipelineBarrier2(commands, full_barrier())
            for step, threads, fields in steps:
                step.record(commands, (threads, 1), **fields)
                vk.vkCmdPipelineBarrier2(commands, full_barrier())
            vk.vkCmdPipelineBarrier2(commands, host_read_barrier())

        self._device.start_with_next(record, what)

    def _kernel(self, name: str) -> Kernel:
        if name not in self._kernels:
            self._kernels[name] = Kernel(self._device, f"scene/given/{name}.comp")
        return self._kernels[name]

    def check(self) -> None:
        """Raise SolariError for a wrong matrix, if the device has come to it. Doesn't wait."""
        if self._wrong is None:
            return
        found: NDArray[np.uint32] = self._wrong.view(np.uint32)
        what, index = divmod(int(found[0]), 1 << 20)
        if what:
            found[0] = 0
            raise SolariError(f"{self._where}: {self._what[what - 1]} of {self._of} {index} must {_RULE}, and wasn't "
                              "in a tensor of an earlier frame")  # fmt: skip

    def destroy(self) -> None:
        """Free everything."""
        for owned in (*self._kernels.values(), self._wrong):
            if owned is not None:
                owned.destroy()
