"""The outline of what is picked, as an image over the picture. Needs no panels library."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.constants import NO_INDEX
from solari_vk.scene.model import Instance
from solari_vk.studio.viewer.pictures import Pictures

COLOR = (255, 160, 40, 255)  # sRGB and alpha


def _instance_numbers(pictures: Pictures) -> NDArray[np.uint32] | None:
    """The number of the instance in each pixel (height, width) of the latest picture, as the binder counts them; None
    before there is a picture."""
    if not pictures.ready or pictures.camera is None:
        return None
    if pictures.mode == "reference":
        assert pictures.reference is not None
        numbers: NDArray[np.uint32] = pictures.reference.tracer["instance_id"]
        return numbers
    assert pictures.realtime is not None
    # The G-buffer's depth is near / distance, 0 for the background, whose surface is left from earlier frames.
    numbers = pictures.realtime["gbuffer_surface"][..., 1]
    return np.where(pictures.realtime["gbuffer_depth"][..., 0] > 0, numbers, np.uint32(NO_INDEX))


def covered(pictures: Pictures, instances: Sequence[Instance]) -> NDArray[np.bool_] | None:
    """The pixels (height, width) of the latest picture that show these instances; None before there is a picture."""
    numbers = _instance_numbers(pictures)
    if numbers is None:
        return None
    rows = [row for row, other in pictures.binder.instances.items() if any(other is instance for instance in instances)]
    found: NDArray[np.bool_] = np.isin(numbers, np.array(rows, numbers.dtype))
    return found


def shares_within(pictures: Pictures, low: tuple[float, float], high: tuple[float, float]) -> dict[Instance, float]:
    """The share of each instance's pixels that are in a rectangle of the latest picture, between two corners (x, y)
    from (0, 0) to (1, 1); of instances that are seen."""
    numbers = _instance_numbers(pictures)
    if numbers is None:
        return {}
    height, width = numbers.shape
    begin = np.clip(np.floor(np.multiply(low, (width, height))), 0, (width, height)).astype(int)
    end = np.clip(np.ceil(np.multiply(high, (width, height))), 0, (width, height)).astype(int)
    seen, counts = np.unique(numbers, return_counts=True)
    inside, inside_counts = np.unique(numbers[begin[1] : end[1], begin[0] : end[0]], return_counts=True)
    within = dict(zip(inside.tolist(), inside_counts.tolist(), strict=True))
    known = pictures.binder.instances
    found = {
        known.get(row): within.get(row, 0) / count for row, count in zip(seen.tolist(), counts.tolist(), strict=True)
    }
    return {instance: share for instance, share in found.items() if instance is not None}


def outline(inside: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """An image (height, width, 4) that is COLOR in the pixels around those inside, and transparent elsewhere."""
    # Dilation by one pixel in four directions, without what is inside.
    padded = np.pad(inside, 1)
    near = padded[:-2, 1:-1] | padded[2:, 1:-1] | padded[1:-1, :-2] | padded[1:-1, 2:]
    image = np.zeros((*inside.shape, 4), np.uint8)
    image[..., :3] = COLOR[:3]  # transparent pixels too, so that filtering doesn't darken the line
    image[near & ~inside, 3] = COLOR[3]
    edge = np.zeros_like(inside)  # where the object goes on beyond the picture
    edge[[0, -1], :] = edge[:, [0, -1]] = True
    image[edge & inside, 3] = COLOR[3]
    return image


class Outline:
    """The outline of instances in the latest picture, which is looked for again when the picture has changed."""

    def __init__(self) -> None:
        self._key: Any = None
        self.image: NDArray[np.uint8] | None = None
        """(height, width, 4), None while nothing is picked."""

    def update(self, pictures: Pictures, instances: Sequence[Instance]) -> bool:
        """Look for the outline if what is shown or picked has changed; returns whether `image` did."""
        if not instances or pictures.camera is None:
            changed = self.image is not None
            self.image = None
            self._key = None
            return changed
        key = tuple(map(id, instances)), pictures.rendered_size, pictures.view_key(pictures.camera)
        if key == self._key:
            return False
        inside = covered(pictures, instances)
        self._key = key
        self.image = None if inside is None else outline(inside)
        return True
