"""What is submitted to the device's queue, prepared once and submitted often."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import ALL_COMMANDS

SemaphoreValue = raw.CData | tuple[raw.CData, int]


class Submission:
    """A VkSubmitInfo2 built once. Submitting it changes its timeline value in place, which costs microseconds.

    waits, signals: semaphores that all commands wait for or signal, those of timelines with their value.
    """

    def __init__(
        self,
        timeline: raw.CData,
        command_buffers: Sequence[raw.CData],
        waits: Sequence[SemaphoreValue] = (),
        signals: Sequence[SemaphoreValue] = (),
    ) -> None:
        self.commands = tuple(command_buffers)
        self._waits, self._signals = _semaphores(waits), _semaphores([timeline, *signals])
        self.signal = self._signals[0]
        self._info = raw.struct(
            "VkSubmitInfo2",
            waitSemaphoreInfoCount=len(waits),
            pWaitSemaphoreInfos=self._waits,
            signalSemaphoreInfoCount=1 + len(signals),
            pSignalSemaphoreInfos=self._signals,
        )
        # Command buffers of others run ahead of these; the array is filled from its end, so few or none cost nothing.
        self._make_room(4)

    def _make_room(self, count: int) -> None:
        """Have an array for `count` command buffers ahead of the submission's own."""
        self._room = count
        self._array = raw.ffi.new("VkCommandBufferSubmitInfo[]", count + len(self.commands))
        for at in range(count + len(self.commands)):
            self._array[at].sType = raw.VK_STRUCTURE_TYPE_COMMAND_BUFFER_SUBMIT_INFO
        for at, commands in enumerate(self.commands, count):
            self._array[at].commandBuffer = commands

    def info_behind(self, ahead: Collection[raw.CData]) -> raw.CData:
        """The VkSubmitInfo2 with other command buffers ahead of the submission's own."""
        if len(ahead) > self._room:
            self._make_room(2 * len(ahead))
        first = self._room - len(ahead)
        for at, commands in enumerate(ahead, first):
            self._array[at].commandBuffer = commands
        self._info.pCommandBufferInfos = self._array + first
        self._info.commandBufferInfoCount = len(ahead) + len(self.commands)
        return self._info


def _semaphores(items: Sequence[SemaphoreValue]) -> raw.CData:
    pairs = [item if isinstance(item, tuple) else (item, 0) for item in items]
    infos = [
        # All commands of a submission wait, and all must be done before it signals.
        raw.struct("VkSemaphoreSubmitInfo", semaphore=semaphore, value=value, stageMask=ALL_COMMANDS)
        for semaphore, value in pairs
    ]
    return raw.array("VkSemaphoreSubmitInfo", infos)
