"""Which light of this frame each light of the last frame is, so that what was sampled then still means the same."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from solari_vk.gpu.device import Device
from solari_vk.gpu.memory import Buffer

GONE = 0xFFFFFFFF  # NO_INDEX of scene/bindings.glsl
NAMES = ("light_translation", "previous_light")

Ids = NDArray[np.uint32]


def translate(of: Ids, to: Ids) -> Ids:
    """For each id of the one list its place in the other, or GONE. Ids of a list differ from each other."""
    if not len(to):
        return np.full(len(of), GONE, np.uint32)
    order = np.argsort(to)
    places = order[np.searchsorted(to, of, sorter=order).clip(max=len(to) - 1)]
    return np.where(to[places] == of, places, GONE).astype(np.uint32)


class LightTranslation:
    """The buffers `light_translation` (last frame's light to this one's) and `previous_light` (the other way round)."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._ids: Ids = np.zeros(0, np.uint32)
        self._settled = False  # whether the buffers say that every light is itself
        self.buffers: dict[str, Buffer] = {}
        self._reserve(1)

    def update(self, ids: Ids) -> bool:
        """Bring the buffers up to date for a frame with these lights; True when they were replaced.

        ids: of the lights in the order of `light_sources`; the same array as long as the list is the same.
        """
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
        self.destroy()
        self.buffers = {name: self._device.buffer(4 * max(2 * count, 16), name) for name in NAMES}
        return True

    def destroy(self) -> None:
        """Free the buffers."""
        for buffer in self.buffers.values():
            buffer.destroy()
        self.buffers = {}
