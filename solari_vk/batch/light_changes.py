"""How the lights of each world of a batch have changed in recent frames: the buffer `world_changes`."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from operator import is_
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.lights.index_translation import share_changed, share_moved, with_decayed
from solari_vk.bound.lights.light_list import LightList
from solari_vk.bound.lights.recent_changes import MAX_CHANGED_LIGHTS, RECORD, RecentChanges
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device

# ChangedLights in glsl/passes/light_change.glsl.
WORLD = np.dtype([("count", "<u4"), ("at", RECORD, MAX_CHANGED_LIGHTS), ("fraction", "<f4")])


class LightState(NamedTuple):
    """What `LightList` knows of the lights of a world, for passes that follow changes."""

    ids: NDArray[np.uint32]
    powers: NDArray[np.float64]
    centers: NDArray[np.float64]
    positions: NDArray[np.float64]

    @classmethod
    def of(cls, lights: LightList) -> LightState:
        """The state of a list of lights, whose arrays it shares."""
        return cls(lights.ids, lights.emitted, lights.centers, lights.positions)


class LightChanges:
    """The changes of the lights of worlds. Worlds that share the scene's lights have one record together."""

    def __init__(self, device: Device, worlds: int) -> None:
        self.buffer: Buffer = device.buffer(worlds * WORLD.itemsize, "world_changes")
        self.newest = np.zeros(1)
        """Of the latest update: the share of the power of each world's lights that was added, removed or moved."""
        self.change = np.zeros(1)
        """The same of recent frames; it decays."""
        self.is_still = True
        """Whether nothing has changed recently: then an update has nothing to do, as long as states stay the same."""
        self._previous: list[LightState] = []
        self._uploaded = False  # whether the buffer has the changes
        self._expected = np.zeros(1)  # in the buffer
        self._recent: list[RecentChanges] = []

    def update(self, states: Sequence[LightState], cell_size: float) -> None:
        """Compare with the lights of the previous frame. states: for each world, or one for all. cell_size: of the
        world cache, in meters."""
        if self.is_still and self._are_previous(states):
            return
        self._uploaded = False
        if not self._previous:
            self._previous = [*states]
            self._recent = [RecentChanges() for _ in states]
        if len(states) > len(self._previous):
            self._split(len(states))
        count = len(self._previous)
        self.newest = np.zeros(count)
        each = [*states] * (count // len(states))
        for world, (before, now, recent) in enumerate(zip(self._previous, each, self._recent, strict=True)):
            # A light list makes new arrays where something changes, so that their identity tells.
            if before is not now and any(a is not b for a, b in zip(before, now, strict=True)):
                changed = share_changed(before.ids, before.powers, now.ids, now.powers)
                moved = share_moved(before.ids, before.positions, now.ids, now.positions, now.powers, cell_size)
                self.newest[world] = max(changed, moved)
            recent.update(now.ids, now.powers, now.centers, now.positions, cell_size)
        self._previous = [*states]
        # Each frame forgets a share of the earlier changes, as the histories that follow them do.
        self.change = with_decayed(self.change, self.newest)
        # The comparison above was by world, since each had lights of its own in the frame before.
        if len(states) < count:
            self._join()
        self._update_stillness()

    def _are_previous(self, states: Sequence[LightState]) -> bool:
        """Whether these were the lights of the previous frame. Their arrays are other objects after each change."""
        return len(states) == len(self._previous) and all(map(is_, chain(*self._previous), chain(*states)))

    def _update_stillness(self) -> None:
        changes = self.change.any() or self.newest.any()
        self.is_still = not (changes or any(len(recent.records) for recent in self._recent))

    def _split(self, count: int) -> None:
        """Go over from lights that worlds share to those of their own."""
        self.change = np.repeat(self.change, count)
        self._previous = self._previous * count
        self._recent = [self._recent[0].copy() for _ in range(count)]

    def _join(self) -> None:
        """Go back to lights that worlds share, with the largest changes of all worlds."""
        self.newest = self.newest.max(keepdims=True)
        self.change = self.change.max(keepdims=True)
        first, *others = self._recent
        for other in others:
            first.merge(other)
        self._recent = [first]

    def clear(self) -> None:
        """Forget all changes so far."""
        self.change = np.zeros(len(self.change))
        self._uploaded = False
        for recent in self._recent:
            recent.clear()
        self._update_stillness()

    def upload(self, expected: NDArray[np.float64]) -> None:
        """Have the next submission see the changes. expected: the share of the light of each world, or of all, that
        edits of any kind may have changed."""
        if self._uploaded and np.array_equal(expected, self._expected):
            return
        self._expected = expected
        records = np.zeros(len(self.change), WORLD)
        records["fraction"] = np.maximum(self.change, expected if len(expected) == len(records) else expected.max())
        for record, recent in zip(records, self._recent, strict=True):
            if recent.records.size:
                record["count"] = len(recent.records)
                record["at"][: len(recent.records)] = recent.records
        self.buffer.upload(records)
        self._uploaded = True
