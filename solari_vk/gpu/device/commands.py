"""Command buffers that stay: a pool of them, and commands that are recorded once and submitted as often as needed."""

from __future__ import annotations

from collections.abc import Callable

from solari_vk.gpu.device import raw
from solari_vk.gpu.device.work_queue import WorkQueue


class CommandPool:
    """Command buffers that can be recorded again."""

    def __init__(self, device: WorkQueue, name: str) -> None:
        self._device = device
        create = raw.struct(
            "VkCommandPoolCreateInfo",
            # Each buffer can be recorded anew by itself; a pool without the flag resets all of them at once.
            flags=raw.VK_COMMAND_POOL_CREATE_RESET_COMMAND_BUFFER_BIT,
            queueFamilyIndex=device.queue_family,
        )
        pool = self._pool = device.create("VkCommandPool", create, name)
        self._token = device.register(lambda: device.vk.vkDestroyCommandPool(device.handle, pool, raw.NULL))

    def allocate(self, count: int) -> list[raw.CData]:
        """New primary command buffers."""
        allocate = raw.struct("VkCommandBufferAllocateInfo", commandPool=self._pool, commandBufferCount=count)
        buffers = raw.ffi.new("VkCommandBuffer[]", count)
        self._device.vk.vkAllocateCommandBuffers(self._device.handle, allocate, buffers)
        return list(buffers)

    def destroy(self) -> None:
        """Free the pool with its buffers when the work submitted so far is done. Safe to call twice."""
        self._device.release(self._token)


class Recorded:
    """A command buffer that may be submitted again while it still runs.

    record(command buffer): records the commands, with the barriers to earlier and later work. The resources that the
    commands use must live as long as this object.
    """

    def __init__(self, device: WorkQueue, record: Callable[[raw.CData], None], name: str) -> None:
        self._device = device
        self._pool = CommandPool(device, name)
        try:
            [self.commands] = self._pool.allocate(1)
            # Vulkan allows a second submission of pending commands only with this flag.
            flags = raw.VK_COMMAND_BUFFER_USAGE_SIMULTANEOUS_USE_BIT
            device.vk.vkBeginCommandBuffer(self.commands, raw.struct("VkCommandBufferBeginInfo", flags=flags))
            with device.label(self.commands, name):
                record(self.commands)
            device.vk.vkEndCommandBuffer(self.commands)
        except BaseException:
            self.destroy()
            raise

    def submit_with_next(self) -> None:
        """Have the commands submitted at the head of the device's next submission."""
        self._device.submit_with_next(self.commands)

    def destroy(self) -> None:
        """Free the commands when the work submitted so far is done. Safe to call twice."""
        self._pool.destroy()
