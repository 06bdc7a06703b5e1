"""PCG hashes and generators, bit for bit."""

from __future__ import annotations

import numpy as np
from support.encodings import pcg4d, pcg_hash, pcg_output, pcg_step

LARGEST = 0xFFFFFFFF


def test_generators(shaders):
    words = np.random.default_rng(1).integers(0, 2**32, (1000, 4), dtype=np.uint32)
    words[:3] = [[0, 0, 0, 0], [LARGEST] * 4, [1, 1, 1, 1]]
    count = len(words)
    outputs = {"hashes": 6 * count, "numbers": 8 * count, "floats": 8 * count, "ranged": 8 * count}
    out = shaders.run("test/random", count, {"words": words}, outputs)
    state = pcg4d(words)[:, 0]
    hashes = np.column_stack([pcg_hash(words[:, 0]), pcg4d(words), state])
    assert (out["hashes"].reshape(-1, 6) == hashes).all()
    for k in range(8):
        state = pcg_step(state)
        number = pcg_output(state).astype(np.uint64)
        assert (out["numbers"][k::8] == number).all()
        assert (out["floats"][k::8] == (number >> 8) / 2**24).all()
        assert (out["ranged"][k::8] == number * words[:, 1] >> 32).all()
