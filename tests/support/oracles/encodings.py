"""Packed formats in numpy, written from the papers and never from the shaders."""

import numpy as np


def decode_rgb9e5(codes):
    """Colors (..., 3) of 9 bits a channel and 5 of exponent (EXT_texture_shared_exponent)."""
    mantissas = np.stack([codes >> shift & 511 for shift in (0, 9, 18)], axis=-1)
    return mantissas * rgb9e5_step(codes)[..., None]


def rgb9e5_step(codes):
    """The distance between neighboring values of each code's channels."""
    return np.ldexp(1.0, (codes >> 27).astype(np.int32) - 24)


def decode_octahedral(codes, bits=16):
    """Unit vectors (..., 3) from codes of two numbers with this many bits each (Cigolle et al. 2014).

    The largest code but one is 1, so that axes are exact.
    """
    mask = (1 << bits) - 1
    square = np.stack([codes & mask, codes >> bits & mask], axis=-1) / (mask - 1) * 2 - 1
    z = 1 - np.abs(square).sum(axis=-1, keepdims=True)
    folded = np.where(z >= 0, square, (1 - np.abs(square[..., ::-1])) * np.where(square >= 0, 1, -1))
    along = np.concatenate([folded, z], axis=-1)
    return along / np.linalg.norm(along, axis=-1, keepdims=True)


def encode_srgb(linear):
    """sRGB codes from 0 to 255, unrounded, of linear values from 0 to 1."""
    linear = np.clip(linear, 0, 1)
    return 255 * np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def decode_srgb(codes):
    """The inverse of encode_srgb."""
    encoded = codes / 255
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
