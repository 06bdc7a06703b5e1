"""PCG hashes and packed colors in numpy, written from the papers and never from the shaders."""

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
    exponent = np.maximum(-16, np.floor(np.log2(np.maximum(largest, 1e-30))).astype(int)) + 16
    exponent += np.floor(np.ldexp(largest, 24 - exponent) + 0.5) == 512
    mantissas = _words(np.floor(np.ldexp(clamped, 24 - exponent) + 0.5))
    return _words((mantissas << _words((0, 9, 18))).sum(axis=-1) + (exponent[..., 0] << 27))
