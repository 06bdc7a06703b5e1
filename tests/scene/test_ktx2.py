"""Pictures in KTX2 files: Basis Universal and plain pixels, damaged ones, and those that expand without bound."""

from __future__ import annotations

import struct
import sys

import numpy as np
import pytest
from support import ktx2_files
from support.ktx2_files import plain

from solari_vk.errors import SolariError
from solari_vk.scene.images.image_files import decode, open_image

NOISE = np.random.default_rng(5).integers(0, 256, (5, 7, 4), dtype=np.uint8)
TWO = np.repeat([[[200, 40, 40, 255]] * 4 + [[40, 40, 200, 128]] * 4], 4, axis=0)


def pixels_of(data):
    return decode(open_image(data, "the lamp"), "the lamp")


@pytest.mark.parametrize("name", ["ETC1S", "UASTC", "UASTC_ZSTD"])
def test_basis_universal(name):
    found = pixels_of(getattr(ktx2_files, name))
    assert found.dtype == np.uint8
    np.testing.assert_allclose(found, TWO, atol=4 if name == "ETC1S" else 0)


@pytest.mark.parametrize("scheme", [0, 2, 3])
@pytest.mark.parametrize(
    ("vk_format", "order"), [(37, "rgba"), (43, "rgba"), (44, "bgra"), (23, "rgb"), (16, "rg"), (9, "r")]
)
def test_plain_pixels(vk_format, order, scheme):
    channels = ["rgba".index(channel) for channel in order]
    expected = np.zeros_like(NOISE)
    expected[..., 3] = 255
    expected[..., channels] = NOISE[..., channels]
    np.testing.assert_array_equal(pixels_of(plain(NOISE[..., channels], vk_format, scheme)), expected)


@pytest.mark.parametrize(
    ("fields", "message"),
    [({"depth": 4}, "save one picture alone"), ({"layers": 2}, "save one picture"), ({"faces": 6}, "save one picture"),
     ({"width": 0}, "save one picture"), ({"width": 16385}, "scale it down"), ({"scheme": 7}, "with 8 bits a channel"),
     ({"format": 97}, "the VkFormat 97"), ({"height": 6}, "bytes of pixels instead of"),
     ({"format": 0, "scheme": 1}, "damaged")],
)  # fmt: skip
def test_other_files_are_refused(fields, message):
    with pytest.raises(SolariError, match=message) as caught:
        pixels_of(plain(NOISE, 37, **fields))
    assert str(caught.value).startswith("the lamp ")


@pytest.mark.parametrize("name", ["ETC1S", "UASTC", "UASTC_ZSTD", "plain", "zstd", "zlib"])
def test_truncated_files_are_refused(name):
    schemes = {"plain": 0, "zstd": 2, "zlib": 3}
    whole = plain(NOISE, 37, schemes[name]) if name in schemes else getattr(ktx2_files, name)
    for length in range(12, len(whole)):
        with pytest.raises(SolariError, match="the lamp"):
            pixels_of(whole[:length])


@pytest.mark.parametrize("scheme", [2, 3])
def test_bombs_expand_to_no_more_than_their_size(scheme):
    import tracemalloc

    bomb = plain(NOISE, 37, scheme, level=bytes(2**28))
    tracemalloc.start()
    with pytest.raises(SolariError, match="bytes of pixels instead of 140"):
        pixels_of(bomb)
    assert tracemalloc.get_traced_memory()[1] < 2**20
    tracemalloc.stop()


def test_basis_files_that_claim_to_expand():
    claim = bytearray(ktx2_files.UASTC_ZSTD)
    claim[96:104] = struct.pack("<Q", 2**40)
    with pytest.raises(SolariError, match="expands to more than its size"):
        pixels_of(bytes(claim))


@pytest.mark.parametrize(
    ("module", "data"), [("opengl_basisu", ktx2_files.UASTC), ("backports.zstd", plain(NOISE, 37, 2))]
)
def test_a_missing_library_is_named_with_what_installs_it(monkeypatch, module, data):
    for name in (module, "compression.zstd"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(SolariError, match=r"the lamp.* needs a library .*pip install 'solari-vk\[formats\]'"):
        pixels_of(data)
