"""What is submitted to the device's queue, prepared once and submitted often."""

from __future__ import annotations

from collections.abc import Sequence

from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import ALL_COMMANDS

Semaphore = tuple[raw.CData, int, int]
"""A semaphore with its timeline value (0 for a binary one) and the stages that wait for it or signal it."""


class Submission:
    """A VkSubmitInfo2 built once. Submitting it changes its timeline value in place, which costs microseconds."""

    def __init__(
        self,
        timeline: raw.CData,
        command_buffers: Sequence[raw.CData],
        waits: Sequence[Semaphore] = (),
        signals: Sequence[Semaphore] = (),
    ) -> None:
        self._commands = tuple(command_buffers)
        self.waits = raw.array("VkSemaphoreSubmitInfo", [_semaphore(*wait) for wait in waits])
        self.signals = raw.array(
            "VkSemaphoreSubmitInfo",
            [_semaphore(timeline, 0, ALL_COMMANDS), *(_semaphore(*signal) for signal in signals)],
        )
        self.signal = self.signals[0]
        self._counts = len(waits), 1 + len(signals)
        self.info = self._info(())
        self._ahead: tuple[raw.CData, ...] = ()
        self._info_behind = self.info

    def _info(self, ahead: tuple[raw.CData, ...]) -> raw.CData:
        commands = [raw.struct("VkCommandBufferSubmitInfo", commandBuffer=item) for item in (*ahead, *self._commands)]
        return raw.struct(
            "VkSubmitInfo2",
            waitSemaphoreInfoCount=self._counts[0],
            pWaitSemaphoreInfos=self.waits,
            commandBufferInfoCount=len(commands),
            pCommandBufferInfos=commands,
            signalSemaphoreInfoCount=self._counts[1],
            pSignalSemaphoreInfos=self.signals,
        )

    def info_behind(self, ahead: tuple[raw.CData, ...]) -> raw.CData:
        """`info` with other command buffers ahead of its own. The result is kept, since the same ones often recur."""
        if ahead != self._ahead:
            self._ahead, self._info_behind = ahead, self._info(ahead)
        return self._info_behind


def _semaphore(semaphore: raw.CData, value: int, stages: int) -> raw.CData:
    return raw.struct("VkSemaphoreSubmitInfo", semaphore=semaphore, value=value, stageMask=stages)
