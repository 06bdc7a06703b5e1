"""Pictures of any brightness for tests: Radiance (.hdr) and OpenEXR."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import OpenEXR


def rgbe(colors):
    """The codes (H, W, 4) of colors (H, W, 3), as Radiance writes them."""
    largest = colors.max(axis=-1)
    mantissa, exponent = np.frexp(largest)
    scale = np.where(largest > 0, mantissa * 256 / np.where(largest > 0, largest, 1), 0)
    codes = np.concatenate([colors * scale[..., None], (exponent + 128)[..., None]], axis=-1).astype(np.uint8)
    codes[largest == 0] = 0
    return codes


def hdr(codes, runs=True, header=b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n"):
    """A Radiance file of codes (H, W, 4), flat or with run lengths."""
    height, width = codes.shape[:2]
    data = header + b"\n-Y %d +X %d\n" % (height, width)
    if not runs:
        return data + codes.tobytes()
    for row in codes:
        data += bytes((2, 2, width >> 8, width & 255))
        for channel in row.T:
            at = 0
            while at < width:
                same = 1
                while at + same < width and same < 127 and channel[at + same] == channel[at]:
                    same += 1
                data += bytes((128 + same, channel[at])) if same > 2 else bytes((1, channel[at]))
                at += same if same > 2 else 1
    return data


def exr(color=(), **channels):
    """The bytes of a picture (2, 3) of one linear color, if there is one."""
    with TemporaryDirectory() as folder:
        path = Path(folder, "x.exr")
        layers = ({"RGB": np.tile(np.float32(color), (2, 3, 1))} if len(color) else {}) | channels
        OpenEXR.File({"type": OpenEXR.scanlineimage}, layers).write(str(path))
        return path.read_bytes()
