"""Environment maps on a device: their texels, and how often light samples take each of them."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.lights.alias_table import alias_table
from solari_vk.bound.lights.emissive_meshes import Emission
from solari_vk.gpu.device.device import Device
from solari_vk.scene.checks import FloatArray
from solari_vk.scene.lights.environment import luminances

# The brightest texel lies between 2^14 and 2^15; rgb9e5 ends at 65408.
_LARGEST_EXPONENT = 14


class EnvironmentBuffers:
    """The buffers of an environment's image. row: the layout of the shaders' AliasTableRow.

    emission: the alias table of the texels. record: the fields of the shaders' Environment that follow from the image.
    """

    def __init__(self, device: Device, row: np.dtype[Any], image: FloatArray) -> None:
        height, width = image.shape[:2]
        codes, scale = encode_texels(image)
        table = alias_table(texel_weights(image).ravel(), row)
        # What was made is freed if the rest can't be made.
        with ExitStack() as unless_made:
            self._texels = device.buffer(codes.nbytes, "environment texels")
            unless_made.callback(self._texels.destroy)
            self._texels.upload(codes)
            self._choices = device.buffer(table.nbytes, "environment choices")
            unless_made.callback(self._choices.destroy)
            self._choices.upload(table)
            unless_made.pop_all()
        self.emission = Emission(1.0, len(table), self._choices)
        self.record = {
            "texels": self._texels.address,
            "choices": self._choices.address,
            "size": (width, height),
            "scale": scale,
        }

    def destroy(self) -> None:
        """Free the buffers."""
        self._texels.destroy()
        self._choices.destroy()


def texel_weights(image: FloatArray) -> NDArray[np.float64]:
    """How much light each texel sends (height, width), up to a factor."""
    return texel_means(image) * np.sin(np.pi * (np.arange(len(image)) + 0.5) / len(image))[:, None]


def texel_means(image: FloatArray) -> NDArray[np.float64]:
    """The mean luminance of each texel (height, width).

    Luminance is interpolated between texels, so a texel has some wherever one of its neighbors has.
    """
    luminance = luminances(image)
    # Linear interpolation gives a texel 3/4 of its own luminance on average, and an eighth of that of each neighbor.
    # Columns go round the horizon, rows end at the poles.
    sides = np.roll(luminance, 1, axis=1) + np.roll(luminance, -1, axis=1)
    blurred = 0.75 * luminance + 0.125 * sides
    padded = np.concatenate([blurred[:1], blurred, blurred[-1:]])
    found: NDArray[np.float64] = 0.75 * blurred + 0.125 * (padded[:-2] + padded[2:])
    return found


def encode_texels(image: FloatArray) -> tuple[NDArray[np.uint32], float]:
    """The codes (height * width,) of an image as rgb9e5, and the radiance of a code for 1, a power of two."""
    # One power of two for the whole image, so that its brightest texel uses the format's largest exponents.
    _, exponent = np.frexp(image.max())
    step = int(exponent) - 1 - _LARGEST_EXPONENT
    colors = np.ldexp(image.reshape(-1, 3), -step)
    largest = np.maximum(np.maximum(colors[:, 0], colors[:, 1]), colors[:, 2])
    _, exponents = np.frexp(largest)
    exponents = np.maximum(exponents + 15, 0)
    # Where the largest channel would round up to 2^9, which has no 9 bits, the exponent is one higher.
    exponents += np.rint(np.ldexp(largest, 24 - exponents)) == 512
    mantissas = np.rint(np.ldexp(colors, (24 - exponents)[:, None])).astype(np.uint32)
    shifts = np.array((0, 9, 18), np.uint32)
    codes: NDArray[np.uint32] = np.bitwise_or.reduce(mantissas << shifts, axis=1)
    return codes | exponents.astype(np.uint32) << np.uint32(27), 2.0**step
