"""Radiance from picture files: .hdr (Radiance RGBE), .exr, and .png and .jpg, whose white is 1."""

from __future__ import annotations

import math
import os
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.budget import charge, load_budget
from solari_vk.base.errors import SolariError, warn
from solari_vk.base.files import read_regular
from solari_vk.scene import checks
from solari_vk.scene.checks import FloatArray
from solari_vk.scene.images import exr, image_files
from solari_vk.scene.images.mip_chain import LINEAR_OF_SRGB

_HEADER = re.compile(rb"#\?(?P<fields>.*?)\r?\n\r?\n(?P<size>[^\n]{0,64}?)\r?\n", re.DOTALL)
_SIZE = re.compile(rb"-Y (\d{1,9}) \+X (\d{1,9})")
_EXPOSURE = re.compile(rb"(?m)^EXPOSURE= *([0-9]+[.]?[0-9]*(?:[eE][+-]?[0-9]+)?) *\r?$")
SMALL_SHARE = 0.01  # of negative light, as filters that sharpen leave beside what is bright
LITTLE_NEGATIVE = "a little negative light, which is taken for 0"
_LONGEST_HEADER = 2**16
_BYTES_PER_PIXEL = 48
_LEAST_RUN_WIDTH, _MOST_RUN_WIDTH = 8, 0x7FFF  # widths of pictures with run lengths


def read_radiance(path: str | os.PathLike[str], data: bytes | None = None) -> FloatArray:
    """Linear colors (height, width, 3) of a picture of all directions.

    data: the file's content, if that is read already. Warns of a picture that isn't twice as wide as high. Raises
    SolariError for files that are missing, damaged, too large or of another kind.
    """
    image = read_colors(path, data)
    source = Path(path)
    height, width = image.shape[:2]
    if width != 2 * height:
        text = f"{source} has {width} x {height} pixels; a picture of all directions is twice as wide as high"
        warn(f"{text}: it is stretched")
    image, is_clipped = light_of(image, str(source))
    if is_clipped:
        warn(f"{source} holds {LITTLE_NEGATIVE}")
    return image


def read_colors(path: str | os.PathLike[str], data: bytes | None = None, what: str = "an environment") -> FloatArray:
    """Linear colors (height, width, 3) as a file has them. what: the picture, for errors: those of `read_radiance`."""
    source = Path(path)
    readers = {".hdr": _read_hdr, ".exr": _read_exr, ".png": _read_8_bits, ".jpg": _read_8_bits, ".jpeg": _read_8_bits}
    reader = readers.get(source.suffix.lower())
    if reader is None:
        raise SolariError(f"{source}: {what} is a file of {', '.join(readers)}, not '{source.suffix}'")
    try:
        with load_budget():
            return reader(read_regular(source, str(source)) if data is None else data, source)
    except MemoryError:
        raise SolariError(f"{source} is too large for this machine's memory: scale it down") from None


def light_of(image: FloatArray, who: str) -> tuple[FloatArray, bool]:
    """The colors of a picture, without a little negative light, and whether it had some.

    Raises SolariError for values that aren't finite, too large, or below 0 otherwise. who: names the picture in errors.
    """
    if not np.isfinite(image).all():
        raise SolariError(f"{who} holds NaN or infinite values: repair it in an image program")
    if image.max() > checks.LARGEST_RADIANCE:
        raise SolariError(f"{who} holds light above {checks.LARGEST_RADIANCE:g}: scale it down in an image program")
    negative = image < 0
    if not negative.any():
        return image, False
    # Filters that sharpen leave a little negative light beside what is bright.
    if -image[negative].sum(dtype=np.float64) > SMALL_SHARE * image[~negative].sum(dtype=np.float64):
        raise SolariError(f"{who} holds negative light: clip it at 0 in an image program")
    return image.clip(0), True


def _check_size(width: int, height: int, source: Path) -> None:
    """Check and charge the size of a picture: its colors, and what the environment computes from them."""
    if not 1 <= min(width, height) <= max(width, height) <= image_files.LARGEST_SIDE or (
        width * height > image_files.LARGEST_PIXEL_COUNT
    ):
        raise SolariError(
            f"{source} has {width} x {height} pixels; from 1 to {image_files.LARGEST_SIDE} a side and "
            f"{image_files.LARGEST_PIXEL_COUNT >> 20} Mi in all are read: scale it down"
        )
    charge(_BYTES_PER_PIXEL * width * height, str(source), f"the picture of {width} x {height} pixels")


def _read_8_bits(data: bytes, source: Path) -> FloatArray:
    opened = image_files.open_image(data, str(source))
    _check_size(opened.width, opened.height, source)
    pixels = image_files.decode(opened, str(source))
    linear: FloatArray = LINEAR_OF_SRGB[pixels[..., :3]]
    return linear


def _read_exr(data: bytes, source: Path) -> FloatArray:
    picture = exr.ExrImage(data, str(source))
    _check_size(picture.width, picture.height, source)
    return picture.colors(str(source))[..., :3]


# ---- Radiance: Ward, "Real Pixels", Graphics Gems II (1991) ------------------------------------------


def _read_hdr(data: bytes, source: Path) -> FloatArray:
    found = _HEADER.match(data[:_LONGEST_HEADER])
    if found is None:
        raise SolariError(f"{source} is not a Radiance picture: its header is missing")
    header = found["fields"]
    line = found["size"]
    if b"FORMAT=32-bit_rle_xyze" in header:
        raise SolariError(f"{source} holds XYZ colors: convert it to RGBE, for example by ra_xyze -r")
    size = _SIZE.fullmatch(line)
    if size is None:
        raise SolariError(f"{source} has the orientation {line[:32]!r}; '-Y height +X width' is read: save it again")
    height, width = int(size[1]), int(size[2])
    _check_size(width, height, source)
    rgbe = _decode_rgbe(data, found.end(), height, width, source)
    # Each program that changed the brightness added a line; the radiance is before all of them.
    exposure = math.prod(float(value) for value in _EXPOSURE.findall(header))
    if not 0 < exposure < math.inf:
        raise SolariError(f"{source} has the EXPOSURE {exposure:g}: save it again")
    exponents = rgbe[..., 3:].astype(np.int32)
    # A mantissa of 8 bits, and an exponent with a bias of 128 that all three share: 2^(e - 128 - 8).
    scale = np.where(exponents > 0, np.ldexp(np.float32(1), exponents - 136), np.float32(0))
    colors: FloatArray = (rgbe[..., :3] * scale / exposure).astype(np.float32)
    return colors


def _decode_rgbe(data: bytes, start: int, height: int, width: int, source: Path) -> NDArray[np.uint8]:
    """The codes (height, width, 4), which are stored flat or as run lengths of each channel of a row."""
    # A row with run lengths begins with two 2s and the width.
    runs = bytes((2, 2, width >> 8, width & 0xFF)) if _LEAST_RUN_WIDTH <= width <= _MOST_RUN_WIDTH else None
    cut = SolariError(f"{source} is cut off or damaged: load it again")
    if runs is None or data[start : start + 4] != runs:
        flat = np.frombuffer(data, np.uint8, offset=start)
        if flat.size < height * width * 4:
            raise cut
        pixels = flat[: height * width * 4].reshape(height, width, 4)
        # Old files repeat a pixel by codes of three 1s, which no writer makes any more.
        if (pixels[..., :3] == 1).all(axis=-1).any():
            raise SolariError(f"{source} has run lengths of an old kind: save it again")
        return pixels
    if len(data) - start < 8 * height:  # before memory is taken
        raise cut
    rows = np.empty((height, 4, width), np.uint8)
    for y in range(height):
        if data[start : start + 4] != runs:
            raise cut
        row, start = _decode_row(data, start + 4, 4 * width)
        if len(row) != 4 * width:
            raise cut
        rows[y] = np.frombuffer(row, np.uint8).reshape(4, width)
    return rows.swapaxes(1, 2)


def _decode_row(data: bytes, start: int, size: int) -> tuple[bytearray, int]:
    """The bytes of a row, at least `size` unless the data are cut off or damaged, and where the next row begins."""
    row = bytearray()
    while len(row) < size and start + 1 < len(data):
        # A count above 128 is a run of one value; a smaller one says how many values follow as they are.
        count = data[start]
        if count > 128:
            row += data[start + 1 : start + 2] * (count - 128)
            start += 2
        elif count == 0:
            break
        else:
            row += data[start + 1 : start + 1 + count]
            start += 1 + count
    return row, start
