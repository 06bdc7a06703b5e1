"""A command pool of its own for commands that are kept."""

from __future__ import annotations

from solari_vk.gpu.device import raw
from solari_vk.gpu.device.work_queue import WorkQueue


class CommandPool:
    """Command buffers that can be recorded again."""

    def __init__(self, device: WorkQueue, name: str) -> None:
        self._device = device
        create = raw.struct(
            "VkCommandPoolCreateInfo",
            flags=raw.VK_COMMAND_POOL_CREATE_RESET_COMMAND_BUFFER_BIT,
            queueFamilyIndex=device.queue_family,
        )
        pool = self._pool = device.create("VkCommandPool", create, name)
        self._token = device.own(lambda: device.vk.vkDestroyCommandPool(device.handle, pool, raw.NULL))

    def allocate(self, count: int) -> list[raw.CData]:
        """New primary command buffers."""
        allocate = raw.struct("VkCommandBufferAllocateInfo", commandPool=self._pool, commandBufferCount=count)
        buffers = raw.ffi.new("VkCommandBuffer[]", count)
        self._device.vk.vkAllocateCommandBuffers(self._device.handle, allocate, buffers)
        return list(buffers)

    def destroy(self) -> None:
        """Free the pool with its buffers when the work submitted so far is done. Safe to call twice."""
        self._device.release(self._token)
