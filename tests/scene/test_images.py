"""Pictures in files of all kinds, damaged ones and those that expand without bound; and mip chains."""

from __future__ import annotations

import struct
import sys
import tracemalloc

import numpy as np
import pytest
from oracles.encodings import decode_srgb
from PIL import Image
from support.files import KTX2_ETC1S, KTX2_UASTC, KTX2_UASTC_ZSTD, image_file, ktx2_file

from solari_vk.base.errors import SolariError
from solari_vk.scene.images.image_files import decode, open_image
from solari_vk.scene.images.mip_chain import mip_chain

NOISE = np.random.default_rng(5).integers(0, 256, (5, 7, 4), dtype=np.uint8)


def decode_image(data, who="the image"):
    return decode(open_image(data, who), who)


# ---- PNG, JPEG and WebP -----------------------------------------------------------------------------


@pytest.mark.parametrize("mode", ["L", "LA", "P", "RGB", "RGBA", "1"])
def test_modes_become_rgba(mode):
    image = Image.fromarray(NOISE).convert(mode)
    found = decode_image(image_file(image))
    assert found.dtype == np.uint8
    np.testing.assert_array_equal(found, np.asarray(image.convert("RGBA")))


def test_transparent_palettes():
    image = Image.new("P", (2, 1))
    image.putpalette([255, 0, 0, 0, 255, 0])
    image.putdata([0, 1])
    assert decode_image(image_file(image, transparency=bytes([255, 7]))).tolist() == [
        [[255, 0, 0, 255], [0, 255, 0, 7]]
    ]


def test_sixteen_bits_are_rounded_to_eight():
    found = decode_image(image_file(Image.fromarray(np.array([[0, 257, 32768, 65535, 128 * 257, 255]], np.uint16))))
    assert found[0].tolist() == [[code, code, code, 255] for code in (0, 1, 128, 255, 128, 1)]


def test_jpeg():
    found = decode_image(image_file(np.full((9, 5, 3), [200, 100, 50]), "JPEG", quality=95))
    np.testing.assert_allclose(found, np.broadcast_to([200, 100, 50, 255], (9, 5, 4)), atol=3)


@pytest.mark.parametrize("lossless", [False, True])
def test_webp(lossless):
    pixels = np.random.default_rng(6).integers(0, 256, (4, 6, 4), dtype=np.uint8).repeat(8, 0).repeat(8, 1)
    found = decode_image(image_file(pixels, "WEBP", lossless=lossless, exact=True, quality=95)).astype(int)
    np.testing.assert_allclose(found, pixels, atol=0 if lossless else 140)  # lossy: half the chroma
    np.testing.assert_allclose(found[4::8, 4::8], pixels[4::8, 4::8], atol=0 if lossless else 25)


# ---- KTX2 -------------------------------------------------------------------------------------------


BASIS_UNIVERSAL = {"ETC1S": KTX2_ETC1S, "UASTC": KTX2_UASTC, "UASTC_ZSTD": KTX2_UASTC_ZSTD}


@pytest.mark.parametrize("name", BASIS_UNIVERSAL)
def test_basis_universal(name):
    two = np.repeat([[[200, 40, 40, 255]] * 4 + [[40, 40, 200, 128]] * 4], 4, axis=0)
    np.testing.assert_allclose(decode_image(BASIS_UNIVERSAL[name]), two, atol=4 if name == "ETC1S" else 0)


@pytest.mark.parametrize("scheme", [0, 2, 3])
def test_plain_pixels(scheme):
    for vk_format, order in ((37, "rgba"), (43, "rgba"), (44, "bgra"), (23, "rgb"), (16, "rg"), (9, "r")):
        channels = ["rgba".index(channel) for channel in order]
        expected = np.zeros_like(NOISE)
        expected[..., 3] = 255
        expected[..., channels] = NOISE[..., channels]
        found = decode_image(ktx2_file(NOISE[..., channels], vk_format, scheme))
        np.testing.assert_array_equal(found, expected, err_msg=order)


# ---- files that are refused -------------------------------------------------------------------------

CLAIM = KTX2_UASTC_ZSTD[:96] + struct.pack("<Q", 2**40) + KTX2_UASTC_ZSTD[104:]
OTHER_FORMAT = "is not a PNG, JPEG, WebP, KTX2, DDS or EXR image, or is damaged"


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", OTHER_FORMAT),
        (b"GIF89a" + b"\0" * 50, OTHER_FORMAT),
        (image_file(NOISE, "GIF"), OTHER_FORMAT),
        (image_file(NOISE[..., :3], "BMP"), OTHER_FORMAT),
        (ktx2_file(NOISE, 37, depth=4), "save one picture alone"),
        (ktx2_file(NOISE, 37, layers=2), "save one picture"),
        (ktx2_file(NOISE, 37, faces=6), "save one picture"),
        (ktx2_file(NOISE, 37, width=0), "save one picture"),
        (ktx2_file(NOISE, 37, width=16385), "scale it down"),
        (ktx2_file(NOISE, 37, scheme=7), "with 8 bits a channel"),
        (ktx2_file(NOISE, 97), "the VkFormat 97"),
        (ktx2_file(NOISE, 37, height=6), "bytes of pixels instead of"),
        (ktx2_file(NOISE, 0, scheme=1), "damaged"),
        (CLAIM, "expands to more than its size"),
    ],
)
def test_other_files_are_refused(data, message):
    with pytest.raises(SolariError, match=f"^the lamp .*{message}"):
        decode_image(data, "the lamp")


KTX2 = BASIS_UNIVERSAL | {f"scheme {scheme}": ktx2_file(NOISE, 37, scheme) for scheme in (0, 2, 3)}


@pytest.mark.parametrize("name", ["PNG", "JPEG", "WEBP", *KTX2])
def test_damaged_files_are_refused_wherever_they_are_cut(name):
    if name in KTX2:
        whole, lengths = KTX2[name], range(12, len(KTX2[name]), 3)
    else:
        whole = image_file(np.random.default_rng(2).integers(0, 256, (16, 16, 3)), name)
        lengths = range(0, len(whole) - 30, 23)
    for length in lengths:
        with pytest.raises(SolariError, match="the lamp"):
            decode_image(whole[:length], "the lamp")


@pytest.mark.parametrize("scheme", [2, 3])
def test_bombs_expand_to_no_more_than_their_size(scheme):
    bomb = ktx2_file(NOISE, 37, scheme, level=bytes(2**25))
    tracemalloc.start()
    with pytest.raises(SolariError, match="bytes of pixels instead of 140"):
        decode_image(bomb)
    assert tracemalloc.get_traced_memory()[1] < 2**20
    tracemalloc.stop()


@pytest.mark.parametrize(
    ("module", "data"), [("opengl_basisu", KTX2_UASTC), ("backports.zstd", ktx2_file(NOISE, 37, 2))]
)
def test_a_missing_library_is_named_with_what_installs_it(monkeypatch, module, data):
    for name in (module, "compression.zstd"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(SolariError, match=r"the lamp.* needs a library .*pip install 'solari-vk\[formats\]'"):
        decode_image(data, "the lamp")


# ---- mip chains -------------------------------------------------------------------------------------


def area_average(values, height, width):
    """Exact averages over the area of each pixel of a smaller picture, by integrating piecewise constants."""
    for axis, size in ((0, height), (1, width)):
        moved = np.moveaxis(values, axis, 0)
        sums = np.concatenate([np.zeros((1, *moved.shape[1:])), np.cumsum(moved, axis=0)])
        edges = np.linspace(0, len(moved), size + 1)
        low = np.minimum(edges.astype(int), len(moved) - 1)
        at = sums[low] + (edges - low).reshape(-1, *[1] * (moved.ndim - 1)) * (sums[low + 1] - sums[low])
        values = np.moveaxis(np.diff(at, axis=0) * size / len(moved), 0, axis)
    return values


@pytest.mark.parametrize("size", [(8, 8), (7, 5), (1, 6), (9, 1), (13, 64), (1, 1)])
@pytest.mark.parametrize("srgb", [False, True])
def test_every_level_is_the_average_of_its_area(size, srgb):
    pixels = np.random.default_rng(4).integers(0, 256, (*size, 4), dtype=np.uint8)
    levels = mip_chain(pixels, srgb)
    assert len(levels) == int(np.log2(max(size))) + 1
    np.testing.assert_array_equal(levels[0], pixels)
    exact = pixels.astype(float)
    colors = slice(0, 3 if srgb else 0)
    exact[..., colors] = decode_srgb(pixels[..., colors])
    for level in levels[1:]:
        exact = area_average(exact, max(exact.shape[0] // 2, 1), max(exact.shape[1] // 2, 1))
        assert (level.shape, level.dtype) == (exact.shape, np.uint8)
        # The nearest code: the exact light is between the midpoints to the neighboring codes.
        assert (exact[..., colors] >= decode_srgb(level[..., colors] - 0.502) - 1e-5).all()
        assert (exact[..., colors] <= decode_srgb(level[..., colors] + 0.502) + 1e-5).all()
        np.testing.assert_allclose(level[..., colors.stop :], exact[..., colors.stop :], atol=0.51)


def test_uniform_images_stay_as_they_are():
    for value in range(256):
        for srgb in (False, True):
            levels = mip_chain(np.full((5, 3, 4), value, np.uint8), srgb)
            assert all((level == value).all() for level in levels)
