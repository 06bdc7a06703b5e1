"""Maps of the light that portals let through, rectified so that each receiver sees a rectangle of them.

Bitterli, Novak and Jarosz, "Portal-Masked Environment Map Sampling" (2015). Coordinates are slopes a against the sides,
mapped to a / (1 + |a|) in place of their angles, which needs no trigonometry. The tables hold whole numbers, so that
sums over small rectangles beside a sun are exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.lights.environment_buffers import texel_means
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.scene.lights.environment import EnvironmentLight, halved_to
from solari_vk.scene.lights.light import Light
from solari_vk.scene.lights.portal import Portal

Floats = NDArray[np.float64]
# Texels along each side of a map: as many as the environment has rows.
LEAST_SIZE = 64
LARGEST_SIZE = 512
_SUM = 2**31  # of a map's weights: shaders still convert floats to such numbers
NO_MAP: dict[str, Any] = {"map": 0, "map_size": 0}


def radiance(luminance: Floats, directions: Floats) -> Floats:
    """The luminance (...) of a map (height, width) in directions (..., 3) of its own space, interpolated."""
    height, width = luminance.shape
    x, y, z = np.moveaxis(directions, -1, 0)
    column = width * (np.arctan2(z, x) / (2 * np.pi) + 0.5) - 0.5
    row = np.clip(height * np.arctan2(np.hypot(x, z), y) / np.pi - 0.5, 0, height - 1)
    first = np.floor(column).astype(int)
    across = column - np.floor(column)
    left = first % width
    right = (first + 1) % width
    top = np.minimum(row.astype(int), max(height - 2, 0))
    bottom = np.minimum(top + 1, height - 1)
    down = row - top
    upper = luminance[top, left] * (1 - across) + luminance[top, right] * across
    lower = luminance[bottom, left] * (1 - across) + luminance[bottom, right] * across
    found: Floats = upper * (1 - down) + lower * down
    return found


def rectified(environments: Sequence[tuple[EnvironmentLight, Floats]], axes: Floats) -> Floats:
    """The light in each texel (2, size, size) of the maps behind and before a portal, up to a factor.

    environments: each with the luminance of its texels. axes (3, 3): `directions_of`. The first map is of directions
    along the normal; rows follow the second side.
    """
    size = max([LEAST_SIZE, *(len(pixels) for _, pixels in environments)])
    # A coordinate c in (-1, 1) is the slope c / (1 - |c|), of which a texel covers the derivative.
    from_middle = (2 * np.arange(size) + 1) / size - 1
    slopes = from_middle / (1 - np.abs(from_middle))
    widths = 1 / (1 - np.abs(from_middle)) ** 2
    sideways = slopes[None, :, None] * axes[0] + slopes[:, None, None] * axes[1]
    towards = np.stack([sideways + axes[2], sideways - axes[2]])
    lengths = np.linalg.norm(towards, axis=-1)
    solid_angles = widths[None, :] * widths[:, None] / lengths**3
    seen = np.zeros_like(lengths)
    for light, pixels in environments:
        seen += light.intensity * radiance(pixels, towards @ light.rotation.astype(np.float64))
    found: Floats = seen * solid_angles
    return found


def _luminance(image: NDArray[np.float32]) -> Floats:
    return texel_means(halved_to(image, LARGEST_SIZE))


def summed_areas(weights: Floats) -> NDArray[np.uint32]:
    """The table (size + 1, size + 1) of the sums of weights (size, size) above and left of each corner, in whole
    numbers of which the largest is 2^31 at most. A texel with any light has at least 1."""
    table = np.zeros((len(weights) + 1, len(weights) + 1), np.uint64)
    total = weights.sum()
    if total > 0:
        # Room for one more of each texel that has light, so that the sum stays within 2^31.
        whole = (weights * ((_SUM - weights.size) / total)).astype(np.uint64) + (weights > 0)
        table[1:, 1:] = whole.cumsum(axis=0).cumsum(axis=1)
    return table.astype(np.uint32)


def directions_of(portal: Portal) -> Floats:
    """Steps (3, 3) of one along the slopes of both sides, and the normal, which size and place leave as they are."""
    sides = 2 * np.stack([portal.half_u, portal.half_v]).astype(np.float64)
    normal = portal.transform[:3, 2]
    across = np.linalg.norm(np.cross(sides[::-1], normal), axis=1) / portal.area
    return np.stack([*(sides * across[:, None]), normal])


class PortalMaps(dict[Light, dict[str, Any]]):
    """The fields of each portal's record that its map says. Portals of the same directions share a map."""

    def __init__(self, device: Device) -> None:
        super().__init__()
        self._device = device
        self._maps: dict[Any, Buffer] = {}  # by the light and the directions that they were made from
        # The luminance of each environment's image by its id, which no other object gets while the image is here.
        self._luminances: dict[int, tuple[Any, Floats]] = {}

    def make(self, portals: Sequence[Portal], environments: Sequence[EnvironmentLight]) -> list[Portal]:
        """Make the maps of these portals under these environments; returns the portals whose map is another now."""
        lit = [light for light in environments if light.emits and portals]
        luminances = {id(light.image): self._luminance_of(light) for light in lit}
        lights = [(light, luminances[id(light.image)][1]) for light in lit]
        self._luminances |= luminances  # also where a map below can't be made
        light_key = _light_key(lit)
        keys: dict[Portal, Any] = {}
        for portal in portals:
            axes = directions_of(portal)
            key = light_key, np.round(axes, 5).tobytes()
            if lit and key not in self._maps:
                self._maps[key] = self._make(lights, axes)
            keys[portal] = key
        self._free_others(set(keys.values()))
        self._luminances = luminances
        before = dict(self)
        self.clear()
        for portal in portals:
            self[portal] = self._record(self._maps[keys[portal]]) if lit else NO_MAP
        return [portal for portal in portals if self[portal] != before.get(portal)]

    def _free_others(self, used: set[Any]) -> None:
        for key in self._maps.keys() - used:
            self._maps.pop(key).destroy()

    def _luminance_of(self, light: EnvironmentLight) -> tuple[Any, Floats]:
        return self._luminances.get(id(light.image)) or (light.image, _luminance(light.image))

    def _make(self, lit: Sequence[tuple[EnvironmentLight, Floats]], axes: Floats) -> Buffer:
        table = np.stack([summed_areas(weights) for weights in rectified(lit, axes)])
        buffer = self._device.buffer(table.nbytes, "portal map")
        try:
            buffer.upload(table)
        except BaseException:
            buffer.destroy()
            raise
        return buffer

    @staticmethod
    def _record(buffer: Buffer) -> dict[str, Any]:
        return {"map": buffer.address, "map_size": round((buffer.size / 8) ** 0.5) - 1}

    def destroy(self) -> None:
        """Free the maps."""
        for buffer in self._maps.values():
            buffer.destroy()
        self._maps = {}


def _light_key(lit: Sequence[EnvironmentLight]) -> tuple[Any, ...]:
    """What maps depend on of environments: maps hold light up to a factor, so that dimming all of them changes none."""
    scale = lit[0].intensity if lit else 1.0
    return tuple((id(light.image), light.rotation.tobytes(), light.intensity / scale) for light in lit)
