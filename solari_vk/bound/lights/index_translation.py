"""Which light of the current frame each light of the previous frame is, so that stored light samples stay valid.

Also measures how much of the light was added, removed or moved in between.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.constants import NO_INDEX
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device

# The factor of `IndexTranslation.changed_power` per frame.
CHANGE_DECAY = 0.9
# A smaller change counts as none.
MIN_CHANGE = 1 / 64
NAMES = ("light_translation", "previous_light")

Ids = NDArray[np.uint32]
Powers = NDArray[np.float64]
Positions = NDArray[np.float64]


def with_decayed(share: Any, newest: Any) -> Any:
    """The share of the light that has changed recently, by that of the previous frame and what changed since then."""
    decayed = share * CHANGE_DECAY
    return np.maximum(np.where(decayed > MIN_CHANGE, decayed, 0.0), newest)


def translate(ids: Ids, others: Ids) -> Ids:
    """The index in `others` of each id, or NO_INDEX. No id occurs twice in either list."""
    if ids is others:
        return np.arange(len(ids), dtype=np.uint32)
    if not len(others):
        return np.full(len(ids), NO_INDEX, np.uint32)
    order = np.argsort(others)
    # An id that isn't there is found beside another one, which the comparison below tells.
    indices = order[np.searchsorted(others, ids, sorter=order).clip(max=len(others) - 1)]
    return np.where(others[indices] == ids, indices, NO_INDEX).astype(np.uint32)


def share_changed(old_ids: Ids, old_powers: Powers, ids: Ids, powers: Powers) -> float:
    """The share, from 0 to 1, of the lights' power that was added or removed between two lists.

    More than half counts as all: what frames remember would otherwise be many times the light that remains.
    """
    total = max(old_powers.sum(), powers.sum())
    if not total > 0:
        return 0.0
    indices = translate(old_ids, ids)
    stayed = indices != NO_INDEX
    before = np.zeros(len(ids))
    before[indices[stayed]] = old_powers[stayed]
    share = float((np.abs(powers - before).sum() + old_powers[~stayed].sum()) / total)
    return 1.0 if share > 0.5 else share


def share_moved(
    old_ids: Ids, old_positions: Positions, ids: Ids, positions: Positions, powers: Powers, cell_size: float
) -> float:
    """The share, from 0 to 1, of the lights' power that moved. A light that moves by half a cell counts half.

    A cache that forgets this share in each frame lags behind by one cell, however fast the lights move.
    """
    total = powers.sum()
    if not total > 0:
        return 0.0
    if old_ids is not ids:
        rows = translate(ids, old_ids)
        stayed = rows != NO_INDEX
        old_positions = old_positions[rows[stayed]]
        positions = positions[stayed]
        powers = powers[stayed]
    distances = np.linalg.norm(positions - old_positions, axis=1)
    return float(powers @ np.minimum(distances / cell_size, 1.0) / total)


def unmoved(ids: Ids, positions: Positions | None, old_ids: Ids, old_positions: Positions | None) -> Ids:
    """The index in the old list of each light that is where it was, or NO_INDEX."""
    indices = translate(ids, old_ids)
    if positions is not old_positions and positions is not None and old_positions is not None:
        stayed = np.flatnonzero(indices != NO_INDEX)
        moved = (positions[stayed] != old_positions[indices[stayed]]).any(axis=1)
        indices[stayed[moved]] = NO_INDEX
    return indices


class IndexTranslation:
    """The buffers `light_translation`, the current index of each light of the previous frame, and `previous_light`.

    `previous_light` is the previous index of each light, but NO_INDEX for one that has moved: pixels of the previous
    frame sampled it elsewhere. Where it was occluded there, their confidence would take its light away.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        self._ids: Ids = np.zeros(0, np.uint32)
        self._powers: Powers | None = None
        self._positions: Positions | None = None
        self.changed_power = 0.0
        """Share of the scene's light that was added, removed or moved recently; decays from frame to frame."""
        self.newest = 0.0  # the same of the latest update alone
        self._is_identity = False  # whether the buffers map each index to itself
        self.buffers: dict[str, Buffer] = {}
        self._replaced = False  # the buffers, since `update` said so
        self._reserve(1)
        self._replaced = False

    def update(self, ids: Ids, powers: Powers, positions: Positions | None = None, cell_size: float = 1.0) -> bool:
        """Update the buffers for a frame with these lights. Returns True if the buffers were replaced.

        ids, powers, positions: of each row of `light_sources`. An array that is the same object as in the previous call
        is taken to be unchanged. cell_size: of the world cache, in meters.
        """
        moves = positions is not self._positions
        self._follow_change(ids, powers, positions, cell_size)
        # In most frames the lights are those of the frame before, and the buffers say so already.
        if ids is self._ids and self._is_identity and not moves and not self._replaced:
            return False
        # Both buffers have room for both lists, whichever is longer.
        self._reserve(max(len(ids), len(self._ids)))
        current = translate(self._ids, ids)
        previous = unmoved(ids, positions, self._ids, self._positions)
        for name, values in zip(NAMES, (current, previous), strict=True):
            if len(values):
                self.buffers[name].upload(values)
        self._is_identity = ids is self._ids and not moves
        self._ids = ids
        self._positions = positions
        replaced = self._replaced
        self._replaced = False
        return replaced

    def _follow_change(self, ids: Ids, powers: Powers, positions: Positions | None, cell_size: float) -> None:
        """Measure how much of the light has changed since the previous frame."""
        self.newest = 0.0
        if powers is not self._powers:
            if self._powers is not None:
                self.newest = share_changed(self._ids, self._powers, ids, powers)
            self._powers = powers
        if self._positions is not None and positions is not None and positions is not self._positions:
            moved = share_moved(self._ids, self._positions, ids, positions, powers, cell_size)
            self.newest = max(self.newest, moved)
        self.changed_power = float(with_decayed(self.changed_power, self.newest))

    def _reserve(self, count: int) -> None:
        if self.buffers and 4 * count <= self.buffers[NAMES[0]].size:
            return
        self.close()
        with self._device.undone_on_error():
            self.buffers = {name: self._device.buffer(4 * max(2 * count, 16), name) for name in NAMES}
        self._replaced = True

    def close(self) -> None:
        """Free the buffers."""
        for buffer in self.buffers.values():
            buffer.destroy()
        self.buffers = {}
