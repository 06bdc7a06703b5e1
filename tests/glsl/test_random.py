"""PCG hashes and generators, bit for bit against Python integers."""

from __future__ import annotations

import numpy as np

MASK = 0xFFFFFFFF


def lcg(state):
    return (state * 747796405 + 2891336453) & MASK


def permute(state):
    word = (((state >> ((state >> 28) + 4)) ^ state) * 277803737) & MASK
    return (word >> 22) ^ word


def mix(values, order):
    """Jarzynski and Olano's pcg3d and pcg4d: `order` lists (target, factor, factor)."""
    v = [(x * 1664525 + 1013904223) & MASK for x in values]
    for _ in range(2):
        for target, a, b in order:
            v[target] = (v[target] + v[a] * v[b]) & MASK
        if _ == 0:
            v = [x ^ (x >> 16) for x in v]
    return v


def pcg3d(values):
    return mix(values, [(0, 1, 2), (1, 2, 0), (2, 0, 1)])


def pcg4d(values):
    return mix(values, [(0, 1, 3), (1, 2, 0), (2, 0, 1), (3, 1, 2)])


def check(shaders):
    rng = np.random.default_rng(1)
    words = rng.integers(0, 2**32, (1000, 4), dtype=np.uint32)
    words[:3] = [[0, 0, 0, 0], [MASK] * 4, [1, 1, 1, 1]]
    count = len(words)
    outputs = {"hashes": 9 * count, "numbers": 8 * count, "floats": 8 * count, "ranged": 8 * count}
    out = shaders.run("test/random", count, {"words": words}, outputs)
    hashes, numbers = out["hashes"].reshape(-1, 9), out["numbers"].reshape(-1, 8)
    floats, ranged = out["floats"].reshape(-1, 8), out["ranged"].reshape(-1, 8)
    for i, word in enumerate(words.tolist()):
        four = pcg4d(word)
        assert hashes[i].tolist() == [permute(lcg(word[0])), *pcg3d(word[:3]), *four, four[0]]
        state = four[0]
        for k in range(8):
            state = lcg(state)
            number = permute(state)
            assert numbers[i, k] == number
            assert floats[i, k] == (number >> 8) / 2**24
            assert ranged[i, k] == number * word[1] >> 32


def test_generators_bit_for_bit(shaders):
    check(shaders)
