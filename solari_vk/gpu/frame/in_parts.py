"""Submitting a frame: at once, or in parts between which it can be given up."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from solari_vk.gpu.device import raw
from solari_vk.gpu.device.commands import Recorded
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.slot import Slot

PAUSE = 0.03  # seconds between two calls of `meanwhile`


class Interrupted(Exception):
    """A frame was given up because `Frame.between` said so."""


class InParts:
    """The part of `Frame` that submits a slot's commands."""

    device: Device
    _slots: list[Slot]
    _order: Recorded
    _between: Callable[[], bool] | None = None
    _clear_counters: Callable[[], None]
    meanwhile: Callable[[], object] | None = None
    """Is called again and again while `submit` waits for a step, if `between` is set. It must not submit work here."""

    @property
    def between(self) -> Callable[[], bool] | None:
        """If set, `submit` waits for each step and calls this after it; True gives the frame up, which `submit` says
        by `Interrupted`: the frame then is to be submitted again, and what its steps keep for the next one is void."""
        return self._between

    @between.setter
    def between(self, between: Callable[[], bool] | None) -> None:
        self._between = between
        for slot in self._slots:
            slot.in_parts = between is not None

    def _submit_slot(self, slot: Slot, before: Sequence[raw.CData]) -> None:
        """Submit what runs before the frame, and the frame."""
        if not slot.in_parts:
            if before:
                self.device.submit([self._order.commands, *before, *slot.submission.commands])
            else:
                self.device.submit_prepared(slot.submission)
            return
        # Each part is a submission that the host waits for, so that nothing runs when the frame is given up.
        self.device.submit([self._order.commands, *before])
        parts = slot.submission.commands
        for number, part in enumerate(parts, 1):
            self._await_part(self.device.submit([part]))
            # The end of the last part is that of the frame: nothing is left to give up.
            if self._between is not None and number < len(parts) and self._between():
                slot.stale = True  # its timestamps are of no frame
                self._clear_counters()
                raise Interrupted

    def _await_part(self, value: int) -> None:
        """Wait for a part, and call `meanwhile`."""
        if self.meanwhile is not None:
            while not self.device.reaches(value, PAUSE):
                self.meanwhile()
        self.device.await_value(value)
