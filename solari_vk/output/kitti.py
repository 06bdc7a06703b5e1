"""Optical flow and disparity as PNG files of 16 bits, as the KITTI benchmarks have them.

Menze and Geiger, "Object Scene Flow for Autonomous Vehicles" (2015), and the development kit of KITTI 2015.
"""

from __future__ import annotations

import os
import struct
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.base.errors import SolariError, checked_keywords
from solari_vk.base.files import followed, write_whole

LARGEST_FLOW = 512.0  # pixels
LARGEST_DISPARITY = 256.0


@checked_keywords(who="solari_vk")
def save_kitti_flow(path: str | os.PathLike[str], flow: ArrayLike, valid: ArrayLike | None = None) -> None:
    """Write optical flow (height, width, 2) in pixels as KITTI's .png.

    valid (height, width): where it counts, by default where it is finite; for "noc", where the other picture shows the
    point (`state == 0`). Steps are of 1/64 pixel. Raises SolariError for other shapes, for flow of 512 pixels and more
    where it counts, and for a file that can't be written.
    """
    values = np.asarray(flow, np.float64)
    if values.ndim != 3 or values.shape[2] != 2:
        raise SolariError(f"{path}: flow has the shape (height, width, 2), not {values.shape}")
    # The difference of both components is finite where both are.
    mask = _valid_mask(path, values[..., 0] - values[..., 1], valid)
    # The development kit reads (code - 2^15) / 64, and the third channel as whether the pixel counts.
    codes = np.rint(_within(path, values, mask[..., None], -LARGEST_FLOW, LARGEST_FLOW, 64) * 64) + (1 << 15)
    pixels = np.where(mask[..., None], np.concatenate([codes, np.ones_like(codes[..., :1])], axis=2), 0)
    write_whole(followed(Path(path)), png_16(pixels.astype(np.uint16)))


@checked_keywords(who="solari_vk")
def save_kitti_disparity(path: str | os.PathLike[str], disparity: ArrayLike, valid: ArrayLike | None = None) -> None:
    """Write disparity (height, width) in pixels as KITTI's .png, in steps of 1/256 pixel.

    valid: as of `save_kitti_flow`. Raises SolariError for other shapes, for disparities below 0 or of 256 and more
    where they count, and for a file that can't be written.
    """
    values = np.asarray(disparity, np.float64)
    if values.ndim != 2:
        raise SolariError(f"{path}: disparity has the shape (height, width), not {values.shape}")
    mask = _valid_mask(path, values, valid)
    codes = np.rint(_within(path, values, mask, 0.0, LARGEST_DISPARITY, 256) * 256)
    # 0 stands for pixels that don't count, so that the least disparity is one step.
    write_whole(followed(Path(path)), png_16(np.where(mask, np.maximum(codes, 1), 0).astype(np.uint16)))


def _valid_mask(
    path: str | os.PathLike[str], values: NDArray[np.float64], valid: ArrayLike | None
) -> NDArray[np.bool_]:
    if valid is None:
        return np.isfinite(values)
    mask = np.asarray(valid)
    if mask.dtype != np.bool_ or mask.shape != values.shape:
        raise SolariError(f"{path}: valid is an array of bool {values.shape}, not of {mask.dtype} {mask.shape}")
    return mask & np.isfinite(values)


def _within(
    path: str | os.PathLike[str],
    values: NDArray[np.float64],
    mask: NDArray[np.bool_],
    low: float,
    high: float,
    steps: int,
) -> NDArray[np.float64]:
    """The values where the mask is true, else 0. steps: in a pixel. Raises SolariError for what the format lacks."""
    inside = np.where(mask, values, 0.0)
    if not (inside.min(initial=0) >= low and inside.max(initial=0) <= high - 1 / steps):
        raise SolariError(
            f"{path}: KITTI's files hold {low:g} to {high - 1 / steps:g} pixels, not {inside.min():.8g} to "
            f"{inside.max():.8g}: leave such pixels out by valid="
        )
    return inside


def png_16(pixels: NDArray[np.uint16]) -> bytes:
    """A PNG file of 16 bits: gray (height, width), or RGB (height, width, 3), which Pillow doesn't write."""
    height, width = pixels.shape[:2]
    color_type = 2 if pixels.ndim == 3 else 0
    rows = pixels.astype(">u2").reshape(height, -1).view(np.uint8)
    # Each line begins with the number of its filter: 0 is none (PNG specification, 9.2).
    lines = np.concatenate([np.zeros((height, 1), np.uint8), rows], axis=1)
    header = struct.pack(">IIBBBBB", width, height, 16, color_type, 0, 0, 0)
    chunks = (b"IHDR", header), (b"IDAT", zlib.compress(lines.tobytes(), 6)), (b"IEND", b"")
    content = b"\x89PNG\r\n\x1a\n"
    for kind, data in chunks:
        content += struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    return content
