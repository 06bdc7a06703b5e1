"""Records packed from plain numbers have the same bytes as those that numpy packs."""

import numpy as np
import pytest

from solari_vk.errors import SolariError
from solari_vk.gpu.frame.packing import packing

RECORD = np.dtype({
    "names": ["matrix", "count", "place", "far", "address"],
    "formats": [("<f4", (4, 3)), "<u4", ("<f4", (2,)), "<i4", "<u8"],
    "offsets": [0, 48, 52, 64, 72],
    "itemsize": 80,
})  # fmt: skip


def pack(record, names, *values):
    packed, begin = packing(record.dtype, names)
    packed.pack_into(record.view(np.uint8).data, begin, *values)


def test_packs_as_numpy_does():
    packed, expected = np.zeros(1, RECORD), np.zeros(1, RECORD)
    matrix = np.random.default_rng(0).normal(size=(4, 3))
    expected["matrix"][0], expected["count"], expected["place"][0] = matrix, 2**32 - 1, (0.1, -2)
    pack(packed, ["matrix", "count"], *matrix.ravel().tolist(), 2**32 - 1)
    pack(packed, ["place"], 0.1, -2)
    assert packed.tobytes() == expected.tobytes()
    pack(packed, ["far"], -5)
    pack(packed, ["address"], 1 << 50)
    assert (packed["far"][0], packed["address"][0], packed["count"][0]) == (-5, 1 << 50, 2**32 - 1)


@pytest.mark.parametrize("names", [["matrix", "place"], ["place", "far"], ["far", "address"], ["count", "matrix"]])
def test_fields_must_follow_each_other(names):
    with pytest.raises(SolariError, match=f"field {names[1]} .* without a gap"):
        packing(RECORD, names)


def test_unknown_fields_are_named():
    with pytest.raises(SolariError, match=r"no field near; there are matrix, count"):
        packing(RECORD, ["matrix", "near"])
