"""GPU times between marks in commands that are recorded outside of frames."""

from __future__ import annotations

import numpy as np

from solari_vk.gpu.device import raw
from solari_vk.gpu.device.device import Device


class Stopwatch:
    """Times of named parts. Call `begin`, then `mark` at the end of each part, in one recording after the other."""

    def __init__(self, device: Device, parts: tuple[str, ...]) -> None:
        self._device = device
        self._parts = parts
        self._count = len(parts) + 1
        self._marked = False
        create = raw.struct("VkQueryPoolCreateInfo", queryType=raw.VK_QUERY_TYPE_TIMESTAMP, queryCount=self._count)
        self._pool = device.create("VkQueryPool", create, "stopwatch")
        self._token = device.register(lambda: device.vk.vkDestroyQueryPool(device.handle, self._pool, raw.NULL))

    def begin(self, commands: raw.CData) -> None:
        """Record the start of the first part."""
        self._device.vk.vkCmdResetQueryPool(commands, self._pool, 0, self._count)
        self._stamp(commands, 0)

    def mark(self, commands: raw.CData, part: str) -> None:
        """Record the end of a part."""
        self._stamp(commands, self._parts.index(part) + 1)
        self._marked = part == self._parts[-1]

    def _stamp(self, commands: raw.CData, at: int) -> None:
        if self._device.timestamp_bits:
            stage = raw.VK_PIPELINE_STAGE_2_ALL_COMMANDS_BIT
            self._device.vk.vkCmdWriteTimestamp2(commands, stage, self._pool, at)

    def read(self) -> dict[str, float]:
        """Milliseconds of each part in the latest commands; waits for them. Empty without timestamps."""
        device = self._device
        if not (device.timestamp_bits and self._marked):
            return {}
        device.wait_idle()
        ticks = np.zeros(self._count, np.uint64)
        device.vk.vkGetQueryPoolResults(
            device.handle,
            self._pool,
            0,
            self._count,
            ticks.nbytes,
            raw.ffi.from_buffer(ticks),
            8,
            raw.VK_QUERY_RESULT_64_BIT,
        )
        mask = np.uint64((1 << device.timestamp_bits) - 1)
        spans = (np.diff(ticks) & mask).astype(np.float64) * device.properties.limits.timestampPeriod * 1e-6
        return dict(zip(self._parts, spans.tolist(), strict=True))

    def destroy(self) -> None:
        """Free it when the work submitted so far is done."""
        self._device.release(self._token)
