"""How bright emissive surfaces are: means of emissive textures over triangles."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.color import LUMINANCE_WEIGHTS
from solari_vk.scene.images.mip_chain import LINEAR_OF_SRGB

if TYPE_CHECKING:
    from solari_vk.scene.material import Texture, TextureImage
    from solari_vk.scene.objects import Mesh

Sums = NDArray[np.int64]
_STEPS = 2**20  # per unit of luminance, so that sums of texels are exact
_ROUNDING = 1e-3  # in texels: coordinates on the border of a texel don't belong to its neighbor


def luminance_sums(image: TextureImage) -> Sums:
    """The summed-area table (height + 1, width + 1) of an sRGB image's luminance, in units of 1 / _STEPS.

    Crow, "Summed-Area Tables for Texture Mapping" (1984).
    """
    height, width = image.pixels.shape[:2]
    sums = np.zeros((height + 1, width + 1), np.int64)
    texels = sums[1:, 1:]
    for channel, weight in enumerate(LUMINANCE_WEIGHTS):
        # Whole numbers, so that differences of large sums are exact.
        texels += np.rint(LINEAR_OF_SRGB * (weight * _STEPS)).astype(np.int64)[image.pixels[..., channel]]
    np.cumsum(texels, axis=0, out=texels)
    np.cumsum(texels, axis=1, out=texels)
    return sums


def mean_luminances(mesh: Mesh, triangles: NDArray[np.uint32], texture: Texture, sums: Sums) -> NDArray[np.float64]:
    """The mean luminance (M,) of a texture over the box of texels around each of the triangles (M, 3)."""
    m = texture.uv_transform.astype(np.float64)
    mesh_uvs = mesh.uvs_for(texture.uv_set)
    uvs = np.zeros((len(mesh.positions), 2)) if mesh_uvs is None else mesh_uvs.astype(np.float64)
    corners = (uvs @ m[:, :2].T + m[:, 2])[triangles]
    left, right = _texels(corners[..., 0], sums.shape[1] - 1, texture.wrap_u)
    top, bottom = _texels(corners[..., 1], sums.shape[0] - 1, texture.wrap_v)
    # The sum over a box from the four corners of the table.
    boxes = sums[bottom, right] - sums[bottom, left] - sums[top, right] + sums[top, left]
    means: NDArray[np.float64] = boxes / ((right - left) * (bottom - top) * float(_STEPS))
    return means


def _texels(coordinates: NDArray[np.float64], size: int, wrap: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The first texel along an axis under coordinates (M, 3), and the end: all texels where the texture wraps around
    inside a triangle."""
    first = np.floor(coordinates.min(axis=1) * size + _ROUNDING)
    end = np.maximum(np.ceil(coordinates.max(axis=1) * size - _ROUNDING), first + 1)
    if wrap == "clamp_to_edge":
        return first.clip(0, size - 1).astype(np.int64), end.clip(1, size).astype(np.int64)
    # In a mirrored period the second half runs backwards.
    period = 2 * size if wrap == "mirrored_repeat" else size
    length = end - first
    first = first % period
    end = first + length
    mirrored = first >= size
    first, end = np.where(mirrored, period - end, first), np.where(mirrored, period - first, end)
    inside = (first >= 0) & (end <= size)
    # Where a triangle reaches over the image's edge, all texels along the axis stand for it.
    return np.where(inside, first, 0).astype(np.int64), np.where(inside, end, size).astype(np.int64)
