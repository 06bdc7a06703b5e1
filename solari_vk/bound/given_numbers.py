"""Numbers that tensors give on the device: shaders write them to memory that the host leaves open.

The host can't see what is wrong with them. A shader refuses a wrong one, and the first `check` that is called when the
device has got so far raises the error.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import DeviceError, SolariError
from solari_vk.gpu.device import dlpack
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.cuda_input import FLOATS, Taken
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.kernel import Kernel

MOST = (1 << 12) - 2  # things that messages tell apart
LAST = (1 << 20) - 1  # the index of what comes after as many others, or more


def is_takable(device: Device, value: Any) -> bool:
    """Whether `take` asks the device's CUDA for a value, or has taken it."""
    if isinstance(value, Taken):
        return value.device is device
    if isinstance(value, np.ndarray) or not hasattr(value, "__dlpack_device__"):
        return False
    if device.closed or device.lost:  # a renderer of it may be left, and ask
        return False
    try:
        kind = int(value.__dlpack_device__()[0])
    except (ValueError, RuntimeError, BufferError):  # such as PyTorch's of the device "meta"
        return False
    return kind in (dlpack.CUDA, dlpack.ROCM) and "shaderFloat64" in device.features


def take(device: Device, value: Any, dtypes: Sequence[Any] = FLOATS) -> Taken | None:
    """A tensor in the device's memory. None for all that the host must read."""
    if not is_takable(device, value):
        return None
    if isinstance(value, Taken):
        return value if value.dtype in dtypes else None
    try:
        return device.cuda_inputs.take(value, dtypes)
    except DeviceError:
        if "cuda_inputs" in vars(device):
            raise
        return None  # CUDA doesn't share this device


class GivenNumbers:
    """Writes numbers of tensors on the device. where: how messages begin. of: what an index counts. rule: that right
    numbers follow."""

    def __init__(self, device: Device, where: str, of: str, rule: str) -> None:
        self._device, self._where, self._of, self._rule = device, where, of, rule
        self._kernels: dict[str, Kernel] = {}
        self._wrong: Buffer | None = None  # in memory that the host sees
        self._what: list[str] = []

    def _source(self, given: Taken, what: str) -> dict[str, Any]:
        """What shaders are told of a tensor. what: for messages."""
        return {
            "floats": given.address,
            "doubles": given.address,
            "is_double": given.dtype == np.float64,
            **self._noting(what),
        }

    def _noting(self, what: str) -> dict[str, Any]:
        """How shaders note that something is wrong."""
        if self._wrong is None:
            self._wrong = self._device.buffer(16, "wrong tensors", host=True)
            self._wrong.write(np.zeros(4, np.uint32))
        if what not in self._what and len(self._what) >= MOST:
            what = "a tensor"
        if what not in self._what:
            self._what.append(what)
        return {"wrong": self._wrong.address, "what": 1 + self._what.index(what)}

    def _kernel(self, name: str) -> Kernel:
        if name not in self._kernels:
            self._kernels[name] = Kernel(self._device, f"scene/given/{name}.comp")
        return self._kernels[name]

    def check(self) -> None:
        """Raise SolariError for what was wrong, if the device has come to it. Doesn't wait."""
        if self._wrong is None:
            return
        found: NDArray[np.uint32] = self._wrong.view(np.uint32)
        what, index = divmod(int(found[0]), 1 << 20)
        if what:
            found[0] = 0
            said = self._said(self._what[what - 1], index)
            raise SolariError(f"{said}, and wasn't in a tensor of an earlier frame")

    def _said(self, what: str, index: int) -> str:
        """What must follow a rule."""
        later = " or a later one" if index == LAST else ""
        return f"{self._where}{what} of {self._of} {index}{later} must {self._rule}"

    def destroy(self) -> None:
        """Free everything."""
        for owned in (*self._kernels.values(), self._wrong):
            if owned is not None:
                owned.destroy()
