"""PCG hashes, packed formats and the packed G-buffer in numpy, written from the papers and never from the shaders."""

import numpy as np

RGB9E5_MAX = 65408.0


def _words(values):
    return np.asarray(values).astype(np.uint32)


def pcg_step(state):
    """The generator's next states (...): O'Neill 2014; Jarzynski and Olano 2020."""
    return _words(state) * _words([747796405]) + _words([2891336453])[0]


def pcg_output(state):
    """The generator's output for its states (the RXS-M-XS permutation)."""
    words = _words(state)
    mixed = ((words >> ((words >> 28) + 4)) ^ words) * _words([277803737])
    return (mixed >> 22) ^ mixed


def pcg_hash(values):
    """pcg: one step, then the output."""
    return pcg_output(pcg_step(values))


def pcg4d(values):
    """Hashes (..., 4) of words (..., 4)."""
    v = _words(values) * _words([1664525]) + _words([1013904223])
    # Two rounds, in which each word takes up the product of two others; a shift mixes high bits into low ones between.
    for last in (False, True):
        for target, a, b in ((0, 1, 3), (1, 2, 0), (2, 0, 1), (3, 1, 2)):
            v[..., target] += v[..., a] * v[..., b]
        if not last:
            v ^= v >> 16
    return v


def encode_rgb9e5(colors):
    """Codes (...) of colors (..., 3) (EXT_texture_shared_exponent, rounding to the nearest)."""
    clamped = np.clip(np.asarray(colors, np.float64), 0, RGB9E5_MAX)
    largest = clamped.max(axis=-1, keepdims=True)
    # The exponent of the largest channel, with the bias of 15 and one more, since mantissas have no leading 1.
    exponent = np.maximum(-16, np.floor(np.log2(np.maximum(largest, 1e-30))).astype(int)) + 16
    # A mantissa that rounds up to 2^9 doesn't fit 9 bits: the next exponent takes it.
    exponent += np.floor(np.ldexp(largest, 24 - exponent) + 0.5) == 512
    mantissas = _words(np.floor(np.ldexp(clamped, 24 - exponent) + 0.5))
    return _words((mantissas << _words((0, 9, 18))).sum(axis=-1) + (exponent[..., 0] << 27))


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
    # Codes to [-1, 1]. Where the upper half of the octahedron ends, the lower one is folded over the edges.
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


GBUFFER_IMAGES = ("gbuffer", "gbuffer_surface", "gbuffer_depth", "motion_vectors")


def decode_gbuffer(frame):
    """Values (h, w[, channels]) of IMAGES in the packed layout, see glsl/passes/gbuffer/gbuffer.glsl.

    `depth` is near / distance along the view axis, 0 where nothing is; `motion` is in parts of the picture's size.
    """
    x, y, z, w = np.moveaxis(frame["gbuffer"].astype(np.int64), -1, 0)
    surface = frame["gbuffer_surface"].astype(np.int64)
    fine_bits = np.array((5, 6, 5))
    coarse = np.stack([x & 255, x >> 8 & 255, x >> 16 & 255], -1)
    fine = np.stack([z >> 16 & 31, z >> 21 & 63, z >> 27 & 31], -1)
    return {
        "color": ((coarse << fine_bits | fine) / ((256 << fine_bits) - 1.0)) ** 2.2,
        "perceptual_roughness": (x >> 24) / 255.0,
        "emissive": decode_rgb9e5(y),
        "reflectance": (z & 255) / 255.0,
        "metallic": (z >> 8 & 255) / 255.0,
        "normal": decode_octahedral(w & 0xFFFFFF, 12),
        "geometric_normal": decode_octahedral(surface[..., 0], 16),
        "instance": surface[..., 1],
        "depth": frame["gbuffer_depth"][..., 0].astype(np.float64),
        "motion": frame["motion_vectors"].astype(np.float64),
    }
