"""Compaction of bottom-level structures: asking how much they need, and copying them into just that."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import full_barrier
from solari_vk.gpu.device.device import Device


class SizeQuery:
    """Asks the device for the compacted sizes of structures, after all builds submitted so far.

    `value` is the timeline's when the answer is there. `read` it once, then or later; or `fetch` it when it is there.
    """

    def __init__(self, device: Device, structures: Sequence[raw.CData]) -> None:
        self._device, self._count = device, len(structures)
        kind = raw.VK_QUERY_TYPE_ACCELERATION_STRUCTURE_COMPACTED_SIZE_KHR
        vk = device.vk
        create = raw.struct("VkQueryPoolCreateInfo", queryType=kind, queryCount=self._count)
        self._pool = pool = device.create("VkQueryPool", create, "compacted sizes")
        self._token = device.own(lambda: vk.vkDestroyQueryPool(device.handle, pool, raw.NULL))
        vk.vkResetQueryPool(device.handle, pool, 0, self._count)
        handles = raw.array("VkAccelerationStructureKHR", structures)
        self.value = device.start(
            lambda cmd: vk.vkCmdWriteAccelerationStructuresPropertiesKHR(cmd, self._count, handles, kind, pool, 0),
            "compacted sizes",
        )

    def read(self) -> list[int]:
        """The sizes in bytes, in the order asked for; waits for them."""
        self._device.await_value(self.value)
        return self.fetch()

    def fetch(self) -> list[int]:
        """The sizes, once the device has come to `value`."""
        device = self._device
        sizes = np.zeros(self._count, np.uint64)
        flags = raw.VK_QUERY_RESULT_64_BIT | raw.VK_QUERY_RESULT_WAIT_BIT
        target = raw.ffi.from_buffer(sizes)
        device.vk.vkGetQueryPoolResults(device.handle, self._pool, 0, self._count, sizes.nbytes, target, 8, flags)
        self.drop()
        return sizes.tolist()

    def drop(self) -> None:
        """Free the query when the device is done with it. Safe to call twice."""
        self._device.release(self._token)


def copy_compacted(device: Device, copies: Sequence[tuple[raw.CData, raw.CData]]) -> None:
    """Submit compacting copies between handles: (source, target)."""
    vk = device.vk

    def record(cmd: raw.CData) -> None:
        vk.vkCmdPipelineBarrier2(cmd, full_barrier())
        for source, target in copies:
            info = raw.struct(
                "VkCopyAccelerationStructureInfoKHR",
                src=source,
                dst=target,
                mode=raw.VK_COPY_ACCELERATION_STRUCTURE_MODE_COMPACT_KHR,
            )
            vk.vkCmdCopyAccelerationStructureKHR(cmd, info)
        vk.vkCmdPipelineBarrier2(cmd, full_barrier())

    if copies:
        device.start(record, "compact blases")


class Preparation:
    """One `Blas.prepare_compaction`: answered once the device has come so far, unless a rebuild cancels it."""

    def __init__(
        self, device: Device, structure: raw.CData, description: str, callback: Callable[[], None] | None
    ) -> None:
        self.size = 0
        self._device = device
        self._description = description
        self._callback = callback
        self._cancelled = False
        self._query = SizeQuery(device, [structure])

    def start(self) -> None:
        """Finish when the device has; that may be at once."""
        self._device.retire(self._finish)

    @property
    def ready(self) -> bool:
        """Whether the size is known; hears of it at once."""
        if not self.size and not self._device.closed:
            self._device.collect()
        return self.size > 0 and not self._cancelled

    def cancel(self) -> None:
        """Never call back, and never be ready."""
        self._cancelled = True

    def _finish(self) -> None:
        """Called when the device has finished, maybe in the middle of a build: the user's callback comes later.

        Also called while the device closes, when there is nothing to tell.
        """
        if self._device.closed:
            return
        if self._cancelled:
            self._query.drop()
            return
        (self.size,) = self._query.fetch()
        if self._callback is not None:
            self._device.callbacks.add(f"prepare_compaction of {self._description}", self._tell)

    def _tell(self) -> None:
        """Call back, unless it was cancelled since it was due."""
        if self._callback is not None and not self._cancelled:
            self._callback()
