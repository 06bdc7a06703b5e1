"""Commands that are recorded once and submitted as often as needed."""

from __future__ import annotations

from collections.abc import Callable

from solari_vk.gpu.device import raw
from solari_vk.gpu.device.work_queue import WorkQueue


class Recorded:
    """A command buffer of its own, which may be submitted again while it still runs.

    record(command buffer): writes the commands, barriers to what comes before and after included. What these use must
    live as long.
    """

    def __init__(self, device: WorkQueue, record: Callable[[raw.CData], None], name: str) -> None:
        self._device = device
        vk = device.vk
        pool = device.create(
            "VkCommandPool", raw.struct("VkCommandPoolCreateInfo", queueFamilyIndex=device.queue_family), name
        )
        self._token = device.own(lambda: vk.vkDestroyCommandPool(device.handle, pool, raw.NULL))
        buffers = raw.ffi.new("VkCommandBuffer[1]")
        try:
            allocate = raw.struct("VkCommandBufferAllocateInfo", commandPool=pool, commandBufferCount=1)
            vk.vkAllocateCommandBuffers(device.handle, allocate, buffers)
            flags = raw.VK_COMMAND_BUFFER_USAGE_SIMULTANEOUS_USE_BIT
            vk.vkBeginCommandBuffer(buffers[0], raw.struct("VkCommandBufferBeginInfo", flags=flags))
            with device.label(buffers[0], name):
                record(buffers[0])
            vk.vkEndCommandBuffer(buffers[0])
        except BaseException:
            self.destroy()
            raise
        self._buffers = buffers

    def submit_with_next(self) -> None:
        """Submit at the head of the device's next submission."""
        self._device.submit_with_next(self._buffers[0])

    def destroy(self) -> None:
        """Free it when the work submitted so far is done. Safe to call twice."""
        self._device.release(self._token)
