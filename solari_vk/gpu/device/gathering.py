"""A device that hands submissions to the driver at once, or several in one call."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager

from solari_vk.gpu.device import raw
from solari_vk.gpu.device.logical import LogicalDevice
from solari_vk.gpu.device.submission import Submission


class GatheringDevice(LogicalDevice):
    """A device whose submissions may be gathered."""

    _gathered: dict[Submission, raw.CData] | None = None  # with what they are submitted with

    @property
    def gathers(self) -> bool:
        """Whether submissions are being gathered."""
        return self._gathered is not None

    @contextmanager
    def gathered(self) -> Iterator[None]:
        """Hand all that is submitted inside to the driver in one call at the end, or as soon as something waits for it.

        The order, and what each submission waits for, stays.
        """
        if self._gathered is not None:
            yield
            return
        self._gathered = {}
        try:
            yield
        finally:
            try:
                self._hand_over()
            finally:
                self._gathered = None

    def _hand_over(self) -> None:
        """Submit what was gathered so far."""
        if self._gathered:
            gathered, self._gathered = self._gathered, {}
            # The order in the array is the order of submission.
            infos = raw.array("VkSubmitInfo2", [*gathered.values()])
            try:
                self.vk.vkQueueSubmit2(self.queue, len(gathered), infos, raw.NULL)
            except BaseException:
                self.lost = True  # the timeline never reaches what counts as submitted
                raise

    def _hand_over_or_gather(self, submission: Submission, value: int, ahead: Collection[raw.CData]) -> None:
        """Submit what signals a value of the timeline, behind other command buffers, now or with what is gathered."""
        if self._gathered is not None and submission in self._gathered:
            self._hand_over()  # a submission holds what it is submitted with
        submission.signal.value = value
        info = submission.info_behind(ahead)
        if self._gathered is None:
            self.vk.vkQueueSubmit2(self.queue, 1, info, raw.NULL)
        else:
            self._gathered[submission] = info
