"""Compaction of bottom-level structures: asking how much they need, and copying them into just that."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import full_barrier

if TYPE_CHECKING:
    from solari_vk.gpu.acceleration.blas import Blas
    from solari_vk.gpu.device.device import Device


class SizeQuery:
    """Asks the device for the compacted sizes of structures, after all builds submitted so far.

    `value` is the timeline's when the answer is there. `read` it once, then or later; or `fetch` it when it is there.
    """

    def __init__(self, device: Device, blases: Sequence[Blas]) -> None:
        self._device, self._count = device, len(blases)
        kind = raw.VK_QUERY_TYPE_ACCELERATION_STRUCTURE_COMPACTED_SIZE_KHR
        vk = device.vk
        create = raw.struct("VkQueryPoolCreateInfo", queryType=kind, queryCount=len(blases))
        self._pool = pool = device.create("VkQueryPool", create, "compacted sizes")
        self._token = device.own(lambda: vk.vkDestroyQueryPool(device.handle, pool, raw.NULL))
        vk.vkResetQueryPool(device.handle, pool, 0, len(blases))
        handles = raw.array("VkAccelerationStructureKHR", [blas.handle for blas in blases])
        self.value = device.start(
            lambda cmd: vk.vkCmdWriteAccelerationStructuresPropertiesKHR(cmd, len(blases), handles, kind, pool, 0),
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


def compact_in_place(device: Device, blases: Sequence[Blas]) -> None:
    """Give structures just built, which nothing refers to yet, storage of the size that they turned out to need."""
    copies, replaced = [], []
    for blas, size in zip(blases, SizeQuery(device, blases).read(), strict=True):
        if 0 < size < blas.size:
            source = blas.handle
            replaced.append(blas.move_to(size))
            copies.append((source, blas.handle))
    copy_compacted(device, copies)
    for free in replaced:
        free()


class Preparation:
    """One `Blas.prepare_compaction`: answered once the device has come so far, unless a rebuild cancels it."""

    def __init__(self, blas: Blas, callback: Callable[[], None] | None) -> None:
        self.size = 0
        self._blas = blas.describe()
        self._callback = callback
        self._cancelled = False
        self._query = SizeQuery(blas.device, [blas])
        self._device = blas.device

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
            self._device.callbacks.add(f"prepare_compaction of {self._blas}", self._tell)

    def _tell(self) -> None:
        """Call back, unless it was cancelled since it was due."""
        if self._callback is not None and not self._cancelled:
            self._callback()
