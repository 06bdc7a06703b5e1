"""Pictures without their background: what surfaces cover, and their light alone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.output.tone_mapping import Colors, encode_picture

if TYPE_CHECKING:
    from solari_vk.scene.lights.environment import EnvironmentLight
    from solari_vk.scene.model import Camera

LEAST_SHARE = 1e-3  # of a pixel by which its light is divided


def backdrop(environment: EnvironmentLight, camera: Camera, size: tuple[int, int]) -> Colors:
    """The radiance (height, width, 3) of the texels of an environment that the pixels' centers show."""
    pixels = np.stack(np.meshgrid(*map(np.arange, size)), axis=-1)
    # Equirectangular, as glsl/scene/lights/environment.glsl reads it: the map's center is towards +x, its top row up.
    x, y, z = np.moveaxis(camera.rays(pixels, size)[1] @ environment.rotation, -1, 0)
    height, width = environment.image.shape[:2]
    column = np.floor((np.arctan2(z, x) / (2 * np.pi) + 0.5) * width).astype(int) % width
    row = np.minimum(np.floor(np.arccos(np.clip(y, -1, 1)) / np.pi * height).astype(int), height - 1)
    found: Colors = environment.image[row, column] * np.float32(environment.intensity)
    return found


def premultiplied(radiance: Colors, coverage: NDArray[Any], behind: Colors | float = 0.0) -> Colors:
    """Radiance (height, width, 3) without what is behind surfaces that cover a share (height, width) of each pixel."""
    # A pixel's light is the mean of the surfaces in it and of what is behind them, by the share that each covers
    # (Porter and Duff, "Compositing Digital Images", 1984). Noise may leave less than nothing.
    share = coverage[..., None]
    return np.where(share > 0, np.maximum(radiance - (1 - share) * behind, 0), 0).astype(np.float32)


def straight(light: Colors, coverage: NDArray[Any]) -> Colors:
    """The mean radiance (height, width, 3) of the surfaces in each pixel, of `premultiplied` light."""
    return np.asarray(light / np.maximum(coverage[..., None], LEAST_SHARE), np.float32)


def encode_transparent(light: Colors, coverage: NDArray[Any], *, exposure: float, curve: str) -> NDArray[np.uint8]:
    """sRGB codes and straight alpha (height, width, 4) of `premultiplied` light; arguments as for `encode_picture`."""
    colors = encode_picture(straight(light, coverage), exposure=exposure, curve=curve)
    alpha = np.round(255 * coverage[..., None]).astype(np.uint8)
    return np.concatenate([np.where(coverage[..., None] > 0, colors, 0).astype(np.uint8), alpha], axis=-1)
