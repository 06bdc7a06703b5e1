"""A buffer that gets the same array again and again, by commands that are recorded once."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import full_barrier
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.commands import Recorded
from solari_vk.gpu.device.device import Device


class Mirror:
    """Has a buffer show an array of bytes, which may change at any time, as of the latest `upload`. then: records
    commands that follow each copy, with the barriers to later work."""

    def __init__(
        self, device: Device, memory: NDArray[np.uint8], name: str, then: Callable[[raw.CData], None] | None = None
    ) -> None:
        self.buffer = device.buffer(memory.nbytes, name)
        self._device = device
        self._memory = memory
        self._then = then
        self._copies: list[tuple[Buffer, Recorded]] = []  # each a copy that is in flight while others are prepared
        self._free: list[tuple[memoryview, raw.CData]] = []  # what the device no longer uses, with its commands

    def upload(self) -> None:
        """Copy the array now, and to the buffer at the head of the next submission. Raises DeviceError for a device
        that is closed."""
        self._device.check_open()
        # A staging buffer that no pending copy reads; with two frames in flight there are soon enough of them.
        free = self._free.pop() if self._free else self._make_copy()
        staging, commands = free
        try:
            staging[:] = self._memory.data
            self._device.submit_with_next(commands)
        except BaseException:
            self._free.append(free)
            raise
        self._device.retire(partial(self._free.append, free))

    def _make_copy(self) -> tuple[memoryview, raw.CData]:
        vk = self._device.vk
        size = self._memory.nbytes

        def record(commands: raw.CData) -> None:
            vk.vkCmdPipelineBarrier2(commands, full_barrier())
            staging.record_copy(commands, self.buffer.handle, size=size)
            vk.vkCmdPipelineBarrier2(commands, full_barrier())
            if self._then is not None:
                self._then(commands)

        with self._device.undone_on_error():
            staging = self._device.buffer(size, f"staging of {self.buffer.name}", host=True)
            recorded = Recorded(self._device, record, f"upload of {self.buffer.name}")
        self._copies.append((staging, recorded))
        return staging.view(np.uint8).data, recorded.commands

    def destroy(self) -> None:
        """Free everything when the work submitted so far is done. Safe to call twice."""
        for staging, recorded in self._copies:
            staging.destroy()
            recorded.destroy()
        self.buffer.destroy()
