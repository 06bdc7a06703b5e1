"""Images of glTF files: by view and by address, and images that can't be read, which cost their texture only."""

from __future__ import annotations

import base64
import struct
import sys

import numpy as np
import pytest
from support.files import KTX2_ETC1S, KTX2_UASTC, exr_file, image_file, ktx2_file

from solari_vk.base.budget import BudgetError, load_budget
from solari_vk.base.errors import SolariError
from solari_vk.scene.images import image_files
from solari_vk.scene.images.ktx2 import IDENTIFIER_OF_KTX_1
from solari_vk.scene.images.mip_chain import LINEAR_OF_SRGB
from solari_vk.scene.material import TEXTURES

LEFT_OUT = "textures whose image can't be read are replaced by another image or their factor: "
NOISE = np.random.default_rng(2).integers(0, 255, (9, 9, 3))
BLUE = np.full((3, 5, 3), [20, 40, 220])


def stored(writer, data, **fields):
    """The number of an image with these bytes."""
    return writer.add("images", bufferView=writer.view(data), **fields)


def show(writer, *slots, **texture):
    """Give the writer a triangle with a texture in some slots of its material; its emission by default."""
    number = writer.add("textures", **texture)
    material = {slot: {"index": number} for slot in slots or ["emissiveTexture"]}
    pbr = {slot: material.pop(slot) for slot in list(material) if slot.startswith(("base", "metal"))}
    number = writer.add("materials", pbrMetallicRoughness=pbr, **material)
    writer.mesh({"TEXCOORD_0": [[0, 0], [1, 0], [0, 1]]}, material=number)


def dx10(block, form, width=4, height=4):
    """A DDS file of blocks of 4 x 4 pixels, in one of the formats of DXGI."""
    header = struct.pack("<7I44x2I4s20xI16x", 124, 0x1007, height, width, len(block), 0, 0, 32, 4, b"DX10", 0x1000)
    return b"DDS " + header + struct.pack("<5I", form, 3, 0, 1, 0) + block


def bc7(color):
    """A block of one color (r, g, b, a) whose values are odd: mode 6, both ends equal."""
    value, place = 1 << 6, 7
    for channel in color:
        value |= (channel >> 1 | channel >> 1 << 7) << place
        place += 14
    return (value | 3 << place).to_bytes(16, "little")


def first_pixel(scene):
    return scene.instances[0].material.emissive_texture.image.pixels[0, 0].tolist()


@pytest.mark.parametrize("packing", ["embedded", "external"])
def test_images_by_uri(writer, packing):
    file = image_file(BLUE, "JPEG")
    folder = writer.path.parent / "a b"
    folder.mkdir()
    (folder / "blue.jpg").write_bytes(file)
    embedded = "data:image/jpeg;base64," + base64.b64encode(file).decode()
    for _ in range(2):
        show(writer, source=writer.add("images", uri=embedded if packing == "embedded" else "a%20b/blue.jpg"))
    scene = writer.load()
    np.testing.assert_allclose(first_pixel(scene), [20, 40, 220, 255], atol=3)
    first, second = (instance.material.emissive_texture.image for instance in scene)
    assert first is second, "one file is one image"


@pytest.mark.parametrize(
    ("extension", "data", "pixel"),
    [
        ("EXT_texture_webp", image_file(BLUE, "WEBP", lossless=True), [20, 40, 220, 255]),
        ("KHR_texture_basisu", KTX2_UASTC, [200, 40, 40, 255]),
        ("KHR_texture_ktx", ktx2_file(np.full((2, 2, 4), 9), 37), [9, 9, 9, 9]),
        ("EXT_texture_exr", exr_file(LINEAR_OF_SRGB[np.array((20, 40, 220))]), [20, 40, 220, 255]),
        ("MSFT_texture_dds", image_file(BLUE, "DDS"), [20, 40, 220, 255]),
    ],
)
@pytest.mark.parametrize("fallback", [False, True])
def test_images_of_extensions_come_before_those_that_replace_them(writer, extension, data, pixel, fallback):
    source = {"extensions": {extension: {"source": stored(writer, data)}}}
    if fallback:
        source["source"] = stored(writer, image_file(np.zeros((1, 1, 3))))
    writer.json["extensionsRequired"] = [extension]
    show(writer, **source)
    scene = writer.load(strict=True)
    assert (first_pixel(scene), scene.warnings) == (pixel, [])


def test_exr_textures_are_colors_or_data_by_what_they_are_for(writer):
    """0.5 is the sRGB code 188 as a color, and 128 as data and as alpha. What is above 1 is clipped, and NaN is 0."""
    show(writer, "baseColorTexture", source=stored(writer, exr_file((0.5, 3.0, np.nan), A=np.full((2, 3), 0.5, "f4"))))
    show(writer, "normalTexture", source=stored(writer, exr_file((0.5, 0.5, 1.0))))
    show(writer, "emissiveTexture", "normalTexture", source=stored(writer, exr_file((0.5, 0.5, 0.5))))
    colored, bumped, both = (instance.material for instance in writer.load(strict=True))
    assert colored.base_color_texture.image.pixels[1, 2].tolist() == [188, 255, 0, 128]
    assert bumped.normal_texture.image.pixels[1, 2].tolist() == [128, 128, 255, 255]
    assert both.normal_texture.image is both.emissive_texture.image
    assert both.emissive_texture.image.pixels[0, 0].tolist() == [188, 188, 188, 255]


@pytest.mark.parametrize(
    ("data", "pixel", "off"),
    [
        (dx10(bc7((201, 41, 43, 255)), 98), [201, 41, 43, 255], 0),
        (image_file(BLUE, "DDS", pixel_format="DXT1"), [20, 40, 220, 255], 4),
        (image_file(BLUE, "DDS", pixel_format="DXT5"), [20, 40, 220, 255], 4),
        (image_file(np.full((8, 8, 3), (204, 128, 0)), "DDS", pixel_format="BC5"), [204, 128, 230, 255], 1),
        (image_file(np.full((4, 4, 4), (1, 2, 3, 4)), "DDS"), [1, 2, 3, 4], 0),
    ],
    ids=["bc7", "bc1", "bc3", "bc5: z = 0.8 completes x = 0.6", "rgba"],
)
def test_dds(writer, data, pixel, off):
    show(writer, source=stored(writer, data))
    np.testing.assert_allclose(first_pixel(writer.load(strict=True)), pixel, atol=off)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (IDENTIFIER_OF_KTX_1 + bytes(99), "image 0 is a KTX 1 file, which isn't read: convert it by ktx2ktx2"),
        (dx10(bytes(16), 95), "image 0 is a DDS image of the format BC6H: save it with 8 bits"),
        (image_file(BLUE, "DDS")[:-9], "image 0 is a damaged DDS image: save it again"),
        (exr_file((1, 1, 1))[:-9], "image 0 is a damaged EXR picture"),
        (exr_file((1, 1, 1))[:40], "image 0 is a damaged EXR picture (index out of range): save it again"),
        (exr_file(Z=np.ones((2, 3), "f4")), "image 0 has no channels R, G and B, nor Y, but Z"),
    ],
)
def test_dds_exr_and_ktx_that_are_not_read(writer, data, reason):
    show(writer, source=stored(writer, data))
    assert writer.load().warnings[0].startswith(LEFT_OUT + reason)


@pytest.mark.parametrize("data", [image_file(NOISE, "DDS"), exr_file((1, 1, 1))])
def test_dds_and_exr_are_charged(data):
    image = image_files.open_image(data, "x")
    needed = 8 * image.width * image.height + image_files.working_bytes(image)
    with load_budget(needed - 1), pytest.raises(BudgetError, match=r"x: the image of \d x \d pixels"):
        image_files.open_image(data, "x")


def test_a_damaged_image_leaves_the_factor(writer):
    slots = ("baseColorTexture", "metallicRoughnessTexture", "normalTexture", "emissiveTexture")
    show(writer, *slots, source=stored(writer, image_file(NOISE)[:99], name="bark"))
    scene = writer.load()
    assert all(getattr(scene.instances[0].material, name) is None for name in TEXTURES)
    [warning] = scene.warnings
    assert warning.startswith(LEFT_OUT + "image 0 'bark' is a damaged image")
    with pytest.raises(SolariError, match=r"file\.glb: image 0 'bark' is a damaged image"):
        writer.load(strict=True)


@pytest.mark.parametrize(
    ("image", "reason"),
    [
        ({"uri": "wood%20grain.png"}, "image 0 needs the file 'wood%20grain.png', which is not beside the glTF file"),
        ({"uri": "notes.txt"}, r"image 0 (notes.txt) is not a PNG, JPEG, WebP, KTX2, DDS or EXR image"),
        ({"uri": "data:;base64,####"}, "image 0 has a data URI that is not valid base64"),
        ({"bufferView": 99}, "image 0 refers to bufferView 99"),
        ({}, "image 0 has a wrong field: 'bufferView'"),
    ],
)
def test_images_that_can_not_be_read_are_named(writer, image, reason):
    (writer.path.parent / "notes.txt").write_text("no picture")
    show(writer, source=writer.add("images", **image))
    scene = writer.load()
    assert scene.instances[0].material.emissive_texture is None
    assert scene.warnings[0].startswith(LEFT_OUT + reason)
    with pytest.raises(SolariError):
        writer.load(strict=True)


def test_another_image_replaces_one_that_needs_a_missing_library(writer, monkeypatch):
    monkeypatch.setitem(sys.modules, "opengl_basisu", None)
    compressed = {"extensions": {"KHR_texture_basisu": {"source": stored(writer, KTX2_ETC1S)}}}
    show(writer, source=stored(writer, image_file(BLUE)), **compressed)
    with pytest.warns(UserWarning, match="Basis Universal.*pip install 'solari-vk") as warned:
        scene = writer.load()
    assert first_pixel(scene) == [20, 40, 220, 255]
    assert [str(one.message) for one in warned] == scene.warnings
