"""Commands that are recorded once and submitted as often as needed."""

from __future__ import annotations

from collections.abc import Callable

from solari_vk.gpu.device import raw
from solari_vk.gpu.device.command_pool import CommandPool
from solari_vk.gpu.device.work_queue import WorkQueue


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
