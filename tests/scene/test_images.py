"""Decoding pictures and making mip chains."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image
from support.gltf_writer import encoded

from solari_vk.errors import SolariError
from solari_vk.scene.images.image_files import decode, open_image
from solari_vk.scene.images.mip_chain import mip_chain


def decode_image(data, who="the image"):
    return decode(open_image(data, who), who)


@pytest.mark.parametrize("mode", ["L", "LA", "P", "RGB", "RGBA", "1"])
def test_modes_become_rgba(mode):
    pixels = np.random.default_rng(1).integers(0, 256, (5, 7, 4), dtype=np.uint8)
    image = Image.fromarray(pixels).convert(mode)
    expected = np.asarray(image.convert("RGBA"))
    found = decode_image(encoded(image))
    assert (found.shape, found.dtype) == ((5, 7, 4), np.uint8)
    np.testing.assert_array_equal(found, expected)


def test_transparent_palettes():
    image = Image.new("P", (2, 1))
    image.putpalette([255, 0, 0, 0, 255, 0])
    image.putdata([0, 1])
    assert decode_image(encoded(image, transparency=bytes([255, 7]))).tolist() == [[[255, 0, 0, 255], [0, 255, 0, 7]]]


def test_sixteen_bits_are_rounded_to_eight():
    gray = np.array([[0, 257, 32768, 65535, 128 * 257, 255]], np.uint16)
    found = decode_image(encoded(Image.fromarray(gray)))
    assert found[0, :, 0].tolist() == [0, 1, 128, 255, 128, 1]
    assert (found[..., 3] == 255).all()
    assert (found[..., 1] == found[..., 0]).all()


def test_jpeg():
    found = decode_image(encoded(np.full((9, 5, 3), [200, 100, 50]), "JPEG", quality=95))
    assert found.shape == (9, 5, 4)
    np.testing.assert_allclose(found, np.broadcast_to([200, 100, 50, 255], (9, 5, 4)), atol=3)


@pytest.mark.parametrize(
    "data", [b"", b"GIF89a" + b"\0" * 50, encoded(np.zeros((9, 9, 3)), "GIF"), encoded(np.zeros((9, 9, 3)), "BMP")]
)
def test_other_files_are_refused(data):
    with pytest.raises(SolariError, match="the sky is not a PNG, JPEG, WebP or KTX2 image, or is damaged"):
        decode_image(data, "the sky")


@pytest.mark.parametrize("lossless", [False, True])
def test_webp(lossless):
    pixels = np.random.default_rng(6).integers(0, 256, (4, 6, 4), dtype=np.uint8).repeat(8, 0).repeat(8, 1)
    found = decode_image(encoded(pixels, "WEBP", lossless=lossless, exact=True, quality=95))
    np.testing.assert_allclose(found.astype(int), pixels, atol=0 if lossless else 140)  # lossy: half the chroma
    np.testing.assert_allclose(found.astype(int)[4::8, 4::8], pixels[4::8, 4::8], atol=0 if lossless else 25)


def test_damaged_files_are_refused_wherever_they_are_cut():
    noise = np.random.default_rng(2).integers(0, 256, (16, 16, 3))
    for format in ("PNG", "JPEG", "WEBP"):
        whole = encoded(noise, format)
        for length in range(0, len(whole) - 30, 23):
            with pytest.raises(SolariError):
                decode_image(whole[:length])


# ---- mip chains -------------------------------------------------------------------------------------


def linear(codes):
    x = np.asarray(codes) / 255
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


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


@pytest.mark.parametrize("size", [(8, 8), (7, 5), (1, 6), (9, 1), (13, 64), (1, 1), (3, 2)])
@pytest.mark.parametrize("srgb", [False, True])
def test_every_level_is_the_average_of_its_area(size, srgb):
    pixels = np.random.default_rng(4).integers(0, 256, (*size, 4), dtype=np.uint8)
    levels = mip_chain(pixels, srgb)
    assert len(levels) == int(np.log2(max(size))) + 1
    np.testing.assert_array_equal(levels[0], pixels)
    exact = pixels.astype(float)
    if srgb:
        exact[..., :3] = linear(pixels[..., :3])
    height, width = size
    for level in levels[1:]:
        height, width = max(height // 2, 1), max(width // 2, 1)
        assert level.shape == (height, width, 4)
        assert level.dtype == np.uint8
        exact = area_average(exact, height, width)
        if srgb:
            # The nearest code: the exact light is between the midpoints to the neighboring codes.
            assert (exact[..., :3] >= linear(level[..., :3] - 0.502) - 1e-5).all()
            assert (exact[..., :3] <= linear(level[..., :3] + 0.502) + 1e-5).all()
            np.testing.assert_allclose(level[..., 3], exact[..., 3], atol=0.51)
        else:
            np.testing.assert_allclose(level, exact, atol=0.51)


def test_black_and_white_average_to_half_the_light():
    pixels = np.zeros((2, 2, 4), np.uint8)
    pixels[0, :, :] = 255
    assert mip_chain(pixels, srgb=True)[1].tolist() == [[[188, 188, 188, 128]]]
    assert mip_chain(pixels, srgb=False)[1].tolist() == [[[128, 128, 128, 128]]]


def test_uniform_images_stay_as_they_are():
    for value in range(256):
        for srgb in (False, True):
            levels = mip_chain(np.full((5, 3, 4), value, np.uint8), srgb)
            assert all((level == value).all() for level in levels)
