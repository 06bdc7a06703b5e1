"""Buffers: device memory with uploads, fills and reads."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import full_barrier
from solari_vk.gpu.device.storage import Storage
from solari_vk.gpu.device.uploads import StagingPool, Uploads


class Buffer(Storage):
    """A buffer as `Device.buffer` makes it; arguments as for `Storage`. Its contents are undefined until written."""

    def __init__(self, staging: StagingPool, size_bytes: int, name: str, **options: Any) -> None:
        super().__init__(staging.memory, size_bytes, name, **options)
        self._staging = staging

    def upload(self, data: Any, offset: int = 0) -> None:
        """Replace bytes; ordered after all work submitted so far and before all later work."""
        with Uploads(self._staging) as uploads:
            uploads.buffer(self, data, offset)

    def fill(self, value: int = 0) -> None:
        """Set every 32-bit word to `value`, just before the next submission."""
        self.check_range(0, 0, "fill")

        def record(cmd: raw.CData) -> None:
            # The buffer may have been destroyed since; its destruction waits for the next submission as well.
            if self.handle is not None:
                vk = self.device.vk
                vk.vkCmdPipelineBarrier2(cmd, full_barrier())
                vk.vkCmdFillBuffer(cmd, self.handle, 0, raw.VK_WHOLE_SIZE, value)
                vk.vkCmdPipelineBarrier2(cmd, full_barrier())

        self.device.before_next_submit(record)

    def read(self, dtype: Any = np.uint8, count: int = -1, offset: int = 0) -> np.ndarray:
        """A copy of `count` elements (-1: all) from a byte offset on; waits for all work submitted so far."""
        dtype, count = self._typed_range(dtype, count, offset, "read")
        if not count:
            return np.empty(0, dtype)
        if self.mapped and self._cached:
            self.device.sync_host()
            return self.view(dtype, count, offset).copy()

        # The host reads uncached memory slowly, so it is copied to cached memory like memory that isn't mapped.
        size = count * dtype.itemsize
        copy = partial(self.record_copy, size=size, offset=offset)
        return self._staging.read_back(size, copy).view(dtype)

    def record_copy(self, cmd: raw.CData, target: raw.CData, *, size: int, offset: int = 0, begin: int = 0) -> None:
        """Record a copy of `size` bytes, from a byte offset on, to a VkBuffer from its byte `begin` on."""
        region = raw.struct("VkBufferCopy", srcOffset=offset, dstOffset=begin, size=size)
        self.device.vk.vkCmdCopyBuffer(cmd, self.handle, target, 1, region)
