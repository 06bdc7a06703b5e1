"""`TensorPort`: makes vertices, texels, material numbers and poses of tensors of CUDA's libraries.

1. `accept` copies a tensor, in the order of its library's stream, to memory that the device owns: a `DeviceTensor`.
   Later changes of the library's tensor don't reach it. What the port doesn't accept, the host reads.
2. `write` runs compute shaders that check the numbers and write them to their place. The host never sees the numbers.
3. `check` raises the error for a number that a shader refused, as soon as the device has got so far.

The assets of a binder have one port and each batch has another one, so that everybody hears of their own tensors only.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple, TypeGuard

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import DeviceError, SolariError
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import full_barrier, host_read_barrier
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.kernel import Kernel
from solari_vk.gpu.tensors import dlpack
from solari_vk.gpu.tensors.imports import FLOATS, DeviceTensor

# A shader records what it refused in one word: 12 bits for the target, from 1 on, and 20 bits for the index.
MAX_TARGETS = (1 << 12) - 1  # stands for all later ones too
LAST_INDEX = (1 << 20) - 1  # stands for all later ones too
REFUSAL_WORDS = 64  # so that refusals of one frame seldom overwrite each other

# The rule of matrices.glsl for transforms and poses.
POSE_RULE = "be finite, affine and invertible, and lie within 1e12"

Shape = tuple[int, ...]


class Dispatch(NamedTuple):
    """A compute shader of glsl/scene/tensors, the invocations in x and y, and its push constants."""

    shader: str
    threads: tuple[int, int]
    pushed: Mapping[str, Any]


class TensorPort:
    """Accepts tensors, writes them where shaders and rays read them, and says which ones were wrong."""

    def __init__(self, device: Device) -> None:
        self.is_used = False
        """Whether the device has read a tensor."""
        self._device = device
        self._kernels: dict[str, Kernel] = {}
        self._refusals: Buffer | None = None  # in memory that the host sees
        self._numbers: dict[Hashable, int] = {}  # of targets of refusals
        self._messages: dict[int, Callable[[int], str]] = {}  # by these numbers
        self._puts_off = False

    # ---- accept -------------------------------------------------------------------------------------

    def sees(self, value: Any) -> bool:
        """Whether a value is a tensor that may be accepted, which is found out without a copy."""
        if isinstance(value, DeviceTensor):
            return value.device is self._device
        if isinstance(value, np.ndarray) or not hasattr(value, "__dlpack_device__"):
            return False
        # A renderer may outlive its device, and is asked as long as it watches the scene.
        if self._device.closed or self._device.lost:
            return False
        try:
            kind = int(value.__dlpack_device__()[0])
        except (ValueError, RuntimeError, BufferError):  # such as PyTorch's tensors of the device "meta"
            return False
        # The shaders that read tensors have doubles.
        return kind in (dlpack.CUDA, dlpack.ROCM) and "shaderFloat64" in self._device.features

    def owns(self, value: Any) -> TypeGuard[DeviceTensor]:
        """Whether a value is a tensor in this device's memory."""
        return isinstance(value, DeviceTensor) and value.device is self._device

    def accept(
        self, value: Any, shapes: Collection[Shape] | None = None, dtypes: Sequence[Any] = FLOATS
    ) -> DeviceTensor | None:
        """A copy of a tensor in the device's memory, or None for what the host must read: anything else than a tensor
        of one of these shapes, or of any by default, and dtypes that CUDA shares with this device."""
        if not self.sees(value) or (shapes is not None and tuple(value.shape) not in shapes):
            return None
        if isinstance(value, DeviceTensor):
            return value if value.dtype in dtypes else None
        try:
            return self._device.tensor_imports.accept(value, dtypes)
        except DeviceError:
            # After a first success CUDA has failed. Else it doesn't share this device, and the host reads the tensor.
            if self._device.has_tensor_imports:
                raise
            return None

    def accept_shaped(self, value: Any, what: str, *shapes: Shape, where: str) -> DeviceTensor | None:
        """As `accept`. Raises SolariError for a tensor of another shape."""
        if self.sees(value) and tuple(value.shape) not in shapes:
            raise SolariError(
                f"{where}: {what} must have the shape {' or '.join(map(str, shapes))}, not {tuple(value.shape)}"
            )
        return self.accept(value, dtypes=FLOATS)

    def accept_fields(
        self, fields: Mapping[str, Any], shapes: Callable[[str], Collection[Shape]], dtypes: Sequence[Any] = FLOATS
    ) -> dict[str, DeviceTensor] | None:
        """The tensors of several fields of an object, or None if the host must read one of them, and so all. shapes:
        those that a field may have."""
        accepted = {}
        for name, value in fields.items():
            tensor = self.accept(value, shapes(name), dtypes)
            if tensor is None:
                return None
            accepted[name] = tensor
        return accepted

    # ---- write --------------------------------------------------------------------------------------

    def source(self, tensor: DeviceTensor) -> dict[str, Any]:
        """The push constants that name a tensor. The shader reads one address as floats or as doubles."""
        self.is_used = True
        return {"floats": tensor.address, "doubles": tensor.address, "is_double": tensor.dtype == np.float64}

    def matrices(self, tensor: DeviceTensor, count: int, origin: NDArray[np.float64]) -> dict[str, Any]:
        """The push constants that name a tensor of `count` matrices (4, 4), which may be parts of larger ones. origin:
        from where what they place shall count its coordinates, (3,)."""
        step = tensor.strides[0] // tensor.dtype.itemsize
        return {**self.source(tensor), "step": step, "count": count, "new_origin": origin}

    def refusal(self, target: Hashable, message: Callable[[int], str]) -> dict[str, int]:
        """The push constants by which a shader records a number that it refuses. target: where the numbers are written
        to. message: makes what `check` says of an index."""
        if self._refusals is None:
            self._refusals = self._device.buffer(4 * REFUSAL_WORDS, "refused tensors", host=True)
            self._refusals.write(np.zeros(REFUSAL_WORDS, np.uint32))
        # Targets beyond the limit share the last number. None of them is stored, as their count has no bound.
        number = self._numbers.get(target, 1 + len(self._numbers))
        if number < MAX_TARGETS:
            self._numbers[target] = number
            self._messages[number] = message
        else:
            number = MAX_TARGETS
            self._messages[number] = _unnamed
        return {"wrong": self._refusals.address + 4 * (number % REFUSAL_WORDS), "what": number}

    def write(
        self,
        dispatches: Sequence[Dispatch],
        name: str,
        *,
        with_next: bool = False,
        before: Callable[[raw.CData], None] | None = None,
        after: Callable[[raw.CData], None] | None = None,
    ) -> None:
        """Submit shaders one after the other, with barriers around each, at once or at the head of the next submission.

        before, after: record commands ahead of the first shader and behind the last one.
        """
        vk = self._device.vk
        # Kernels are compiled before anything is recorded, so that an error leaves no commands behind.
        kernels = [self._kernel(dispatch.shader) for dispatch in dispatches]

        def record(commands: raw.CData) -> None:
            if before is not None:
                vk.vkCmdPipelineBarrier2(commands, full_barrier())
                before(commands)
            for kernel, dispatch in zip(kernels, dispatches, strict=True):
                vk.vkCmdPipelineBarrier2(commands, full_barrier())
                kernel.record(commands, dispatch.threads, **dispatch.pushed)
            vk.vkCmdPipelineBarrier2(commands, full_barrier())
            if after is not None:
                after(commands)
            vk.vkCmdPipelineBarrier2(commands, host_read_barrier())  # of refusals

        if with_next:
            self._device.start_with_next(record, name)
        else:
            self._device.start(record, name)

    def _kernel(self, shader: str) -> Kernel:
        if shader not in self._kernels:
            self._kernels[shader] = Kernel(self._device, f"scene/tensors/{shader}.comp")
        return self._kernels[shader]

    # ---- check --------------------------------------------------------------------------------------

    def check(self) -> None:
        """Raise SolariError for a number that was refused, if the device has come to it. Doesn't wait."""
        if self._refusals is None or self._puts_off:
            return
        words = self._refusals.view(np.uint32)
        refused = np.flatnonzero(words)
        if len(refused) == 0:
            return
        number, index = divmod(int(words[refused[0]]), 1 << 20)
        words[refused[0]] = 0
        raise SolariError(f"{self._messages[number](index)}, and wasn't in a tensor of an earlier frame")

    @contextmanager
    def putting_off(self) -> Iterator[None]:
        """Leave what the device refuses meanwhile to the next `check` after the block, so that this one ends whole."""
        self._puts_off = True
        try:
            yield
        finally:
            self._puts_off = False

    def destroy(self) -> None:
        """Free everything."""
        for owned in (*self._kernels.values(), self._refusals):
            if owned is not None:
                owned.destroy()


def rule(target: str, of: str, must: str) -> Callable[[int], str]:
    """The message that a target's part must follow a rule. of: what an index counts."""

    def message(index: int) -> str:
        later = " or a later one" if index == LAST_INDEX else ""
        return f"{target} of {of} {index}{later} must {must}"

    return message


def _unnamed(index: int) -> str:
    return f"number {index} of a tensor must be finite, and lie in the range of its field"
