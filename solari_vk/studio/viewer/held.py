"""A picture that stays in the window while a larger one begins."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from solari_vk.gpu.device import raw
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.image import Image
from solari_vk.studio.viewer.presenter import Part


class Held:
    """A copy of a picture. `drop` frees it."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._image: Image | None = None

    def keep(self, pixels: NDArray[np.uint8]) -> None:
        """Hold these pixels (height, width, 3)."""
        height, width = pixels.shape[:2]
        if self._image is None or (self._image.width, self._image.height) != (width, height):
            self.drop()
            usage = raw.VK_IMAGE_USAGE_STORAGE_BIT  # storage images stay in a layout that copies may read
            self._image = self._device.image(width, height, raw.VK_FORMAT_R8G8B8A8_UNORM, "held picture", usage=usage)
        opaque = np.full((height, width, 4), 255, np.uint8)
        opaque[..., :3] = pixels
        self._image.upload([opaque])

    @property
    def parts(self) -> list[Part]:
        """What the window shows, an empty list without a picture."""
        return [] if self._image is None else [Part(self._image)]

    def drop(self) -> None:
        """Free the picture. Safe to call twice."""
        if self._image is not None:
            self._image.destroy()
            self._image = None
