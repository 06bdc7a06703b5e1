"""A submission to a queue, prepared once and made as often as wanted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from solari_vk.gpu import raw
from solari_vk.gpu.barriers import ALL_COMMANDS

if TYPE_CHECKING:
    from solari_vk.gpu.device import Device


class Submission:
    """A VkSubmitInfo2 built once. Its timeline value is changed in place, so that submitting costs microseconds."""

    def __init__(
        self,
        device: Device,
        command_buffers: Sequence[raw.CData],
        waits: Sequence[tuple[raw.CData, int, int]] = (),
        signals: Sequence[tuple[raw.CData, int, int]] = (),
    ) -> None:
        self._device = device
        commands = [raw.struct("VkCommandBufferSubmitInfo", commandBuffer=item) for item in command_buffers]
        self.waits = raw.array("VkSemaphoreSubmitInfo", [_semaphore(*wait) for wait in waits])
        self.signals = raw.array(
            "VkSemaphoreSubmitInfo",
            [_semaphore(device.timeline, 0, ALL_COMMANDS), *(_semaphore(*signal) for signal in signals)],
        )
        self.signal = self.signals[0]
        self.info = raw.struct(
            "VkSubmitInfo2",
            waitSemaphoreInfoCount=len(waits),
            pWaitSemaphoreInfos=self.waits,
            commandBufferInfoCount=len(commands),
            pCommandBufferInfos=commands,
            signalSemaphoreInfoCount=1 + len(signals),
            pSignalSemaphoreInfos=self.signals,
        )

    def submit(self) -> int:
        """Submit; returns the value that the device's timeline reaches when the commands are done."""
        return self._device._submit(self)


def _semaphore(semaphore: raw.CData, value: int, stages: int) -> raw.CData:
    return raw.struct("VkSemaphoreSubmitInfo", semaphore=semaphore, value=value, stageMask=stages)
