"""What is submitted to the device's queue, prepared once and submitted often."""

from __future__ import annotations

from collections.abc import Sequence

from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import ALL_COMMANDS


class Submission:
    """A VkSubmitInfo2 built once. Submitting it changes its timeline value in place, which costs microseconds.

    waits, signals: binary semaphores that all commands wait for or signal.
    """

    def __init__(
        self, timeline: raw.CData, command_buffers: Sequence[raw.CData], waits: Sequence[raw.CData] = (),
        signals: Sequence[raw.CData] = (),
    ) -> None:  # fmt: skip
        self._commands = tuple(command_buffers)
        self._waits, self._signals = _semaphores(waits), _semaphores([timeline, *signals])
        self.signal = self._signals[0]
        self._counts = len(waits), 1 + len(signals)
        self.info = self._info(())
        self._ahead: tuple[raw.CData, ...] = ()
        self._info_behind = self.info

    def _info(self, ahead: tuple[raw.CData, ...]) -> raw.CData:
        commands = [raw.struct("VkCommandBufferSubmitInfo", commandBuffer=item) for item in (*ahead, *self._commands)]
        return raw.struct(
            "VkSubmitInfo2",
            waitSemaphoreInfoCount=self._counts[0],
            pWaitSemaphoreInfos=self._waits,
            commandBufferInfoCount=len(commands),
            pCommandBufferInfos=commands,
            signalSemaphoreInfoCount=self._counts[1],
            pSignalSemaphoreInfos=self._signals,
        )

    def info_behind(self, ahead: tuple[raw.CData, ...]) -> raw.CData:
        """`info` with other command buffers ahead of its own. The result is kept, since the same ones often recur."""
        if ahead != self._ahead:
            self._ahead, self._info_behind = ahead, self._info(ahead)
        return self._info_behind


def _semaphores(items: Sequence[raw.CData]) -> raw.CData:
    infos = [raw.struct("VkSemaphoreSubmitInfo", semaphore=item, stageMask=ALL_COMMANDS) for item in items]
    return raw.array("VkSemaphoreSubmitInfo", infos)
