"""Compaction of bottom-level structures: queries of their compacted sizes, and compacting copies."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import full_barrier
from solari_vk.gpu.device.device import Device


class SizeQuery:
    """Queries the compacted sizes of structures, after all builds submitted so far.

    The result is there when the timeline reaches `value`. Call `read`, or `fetch` if that is reached, once.
    """

    def __init__(self, device: Device, structures: Sequence[raw.CData]) -> None:
        self._device = device
        self._count = len(structures)
        kind = raw.VK_QUERY_TYPE_ACCELERATION_STRUCTURE_COMPACTED_SIZE_KHR
        vk = device.vk
        create = raw.struct("VkQueryPoolCreateInfo", queryType=kind, queryCount=self._count)
        self._pool = pool = device.create("VkQueryPool", create, "compacted sizes")
        self._token = device.register(lambda: vk.vkDestroyQueryPool(device.handle, pool, raw.NULL))
        # On the host (hostQueryReset), since no command buffer has used the new pool.
        vk.vkResetQueryPool(device.handle, pool, 0, self._count)
        handles = raw.array("VkAccelerationStructureKHR", structures)
        self.value = device.start(
            lambda cmd: vk.vkCmdWriteAccelerationStructuresPropertiesKHR(cmd, self._count, handles, kind, pool, 0),
            "compacted sizes",
        )

    def read(self) -> list[int]:
        """The sizes in bytes, in the order of the structures; waits for them."""
        self._device.await_value(self.value)
        return self.fetch()

    def fetch(self) -> list[int]:
        """The sizes in bytes, without waiting: the timeline must have reached `value`."""
        device = self._device
        sizes = np.zeros(self._count, np.uint64)
        # The timeline has passed the query, so VK_QUERY_RESULT_WAIT_BIT never waits long here.
        flags = raw.VK_QUERY_RESULT_64_BIT | raw.VK_QUERY_RESULT_WAIT_BIT
        target = raw.ffi.from_buffer(sizes)
        device.vk.vkGetQueryPoolResults(device.handle, self._pool, 0, self._count, sizes.nbytes, target, 8, flags)
        self.drop()
        return sizes.tolist()

    def drop(self) -> None:
        """Free the query when the device no longer uses it. Safe to call twice."""
        self._device.release(self._token)


def copy_compacted(device: Device, copies: Sequence[tuple[raw.CData, raw.CData]]) -> None:
    """Submit compacting copies between structures; each copy is (source, target)."""
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
    """The state of a `Blas.prepare_compaction`: ready once the device has finished, unless it was canceled."""

    def __init__(
        self, device: Device, structure: raw.CData, description: str, callback: Callable[[], None] | None
    ) -> None:
        self.size = 0
        self._device = device
        self._description = description
        self._callback = callback
        self._canceled = False
        self._query = SizeQuery(device, [structure])
        device.retire(self._finish)

    @property
    def ready(self) -> bool:
        """Whether the size is known and the preparation wasn't canceled."""
        if not self.size and not self._device.closed:
            self._device.collect()
        return self.size > 0 and not self._canceled

    def cancel(self) -> None:
        """Never become ready, and don't call the callback."""
        self._canceled = True

    def _finish(self) -> None:
        """Fetch the size and queue the user's callback. Runs when the device has finished, maybe during another build.

        Also runs while the device closes, and does nothing then.
        """
        if self._device.closed:
            return
        if self._canceled:
            self._query.drop()
            return
        (self.size,) = self._query.fetch()
        if self._callback is not None:
            self._device.callbacks.add(f"prepare_compaction of {self._description}", self._tell)

    def _tell(self) -> None:
        """Call the user's callback, unless the preparation was canceled in the meantime."""
        if self._callback is not None and not self._canceled:
            self._callback()
