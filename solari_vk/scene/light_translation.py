"""Which light of this frame each light of the last frame is, so that what was sampled then still means the same.

And how much light came, went or moved in between.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.scene.constants import NO_INDEX

KEPT = 0.9  # of a change that light is still settling from, after a frame
SETTLED = 1 / 64
NAMES = ("light_translation", "previous_light")

Ids = NDArray[np.uint32]
Powers = NDArray[np.float64]
Places = NDArray[np.float64]


def translate(of: Ids, to: Ids) -> Ids:
    """For each id of the one list its place in the other, or NO_INDEX. Ids of a list differ from each other."""
    if not len(to):
        return np.full(len(of), NO_INDEX, np.uint32)
    order = np.argsort(to)
    places = order[np.searchsorted(to, of, sorter=order).clip(max=len(to) - 1)]
    return np.where(to[places] == of, places, NO_INDEX).astype(np.uint32)


def share_changed(of: Ids, powers: Powers, to: Ids, new_powers: Powers) -> float:
    """How much of the lights' power came or went from one list to the other, from 0 to 1."""
    most = max(powers.sum(), new_powers.sum())
    if not most > 0:
        return 0.0
    places = translate(of, to)
    stayed = places != NO_INDEX
    before = np.zeros(len(to))
    before[places[stayed]] = powers[stayed]
    return float(min((np.abs(new_powers - before).sum() + powers[~stayed].sum()) / most, 1.0))


def share_moved(of: Ids, places: Places, to: Ids, new_places: Places, new_powers: Powers, cell_size: float) -> float:
    """The share, from 0 to 1, of the lights' power that moved, where a light that moves by a cell moves wholly.

    A cache that forgets by such a share a frame lags behind by a cell, however fast lights move.
    """
    total = new_powers.sum()
    if not total > 0:
        return 0.0
    if of is not to:
        rows = translate(to, of)
        stayed = rows != NO_INDEX
        places, new_places, new_powers = places[rows[stayed]], new_places[stayed], new_powers[stayed]
    distances = np.linalg.norm(new_places - places, axis=1)
    return float(new_powers @ np.minimum(distances / cell_size, 1.0) / total)


class LightTranslation:
    """The buffers `light_translation` (last frame's light to this one's) and `previous_light` (the other way round)."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._ids: Ids = np.zeros(0, np.uint32)
        self._powers: Powers | None = None
        self._places: Places | None = None
        self.change = 0.0
        """Share of the scene's light that came, went or moved of late, fading from frame to frame."""
        self._settled = False  # whether the buffers say that every light is itself
        self.buffers: dict[str, Buffer] = {}
        self._reserve(1)

    def update(self, ids: Ids, powers: Powers, places: Places | None = None, cell_size: float = 1.0) -> bool:
        """Bring the buffers up to date for a frame with these lights; True when they were replaced.

        ids, powers and places: of the lights in the order of `light_sources`; the same arrays as long as they are the
        same. cell_size: of the world cache, in metres.
        """
        self.change = KEPT * self.change if KEPT * self.change > SETTLED else 0.0
        if powers is not self._powers:
            if self._powers is not None:
                self.change = max(self.change, share_changed(self._ids, self._powers, ids, powers))
            self._powers = powers
        if places is not self._places:
            if self._places is not None and places is not None:
                moved = share_moved(self._ids, self._places, ids, places, powers, cell_size)
                self.change = max(self.change, moved)
            self._places = places
        if ids is self._ids and self._settled:
            return False
        replaced = self._reserve(max(len(ids), len(self._ids)))
        for name, values in zip(NAMES, (translate(self._ids, ids), translate(ids, self._ids)), strict=True):
            if len(values):
                self.buffers[name].upload(values)
        self._settled = ids is self._ids
        self._ids = ids
        return replaced

    def _reserve(self, count: int) -> bool:
        if self.buffers and 4 * count <= self.buffers[NAMES[0]].size:
            return False
        self.close()
        self.buffers = {name: self._device.buffer(4 * max(2 * count, 16), name) for name in NAMES}
        return True

    def close(self) -> None:
        """Free the buffers."""
        for buffer in self.buffers.values():
            buffer.destroy()
        self.buffers = {}
