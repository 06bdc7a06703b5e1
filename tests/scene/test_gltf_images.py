"""Images of glTF files: by view and by address, and images that can't be read, which cost their texture only."""

from __future__ import annotations

import base64
import sys

import numpy as np
import pytest
from support import ktx2_files
from support.gltf_writer import encoded

from solari_vk.errors import SolariError
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


def first_pixel(scene):
    return scene.instances[0].material.emissive_texture.image.pixels[0, 0].tolist()


@pytest.mark.parametrize("packing", ["embedded", "external"])
def test_images_by_uri(writer, packing):
    file = encoded(BLUE, "JPEG")
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
        ("EXT_texture_webp", encoded(BLUE, "WEBP", lossless=True), [20, 40, 220, 255]),
        ("KHR_texture_basisu", ktx2_files.UASTC, [200, 40, 40, 255]),
    ],
)
@pytest.mark.parametrize("fallback", [False, True])
def test_images_of_extensions_come_before_those_that_replace_them(writer, extension, data, pixel, fallback):
    source = {"extensions": {extension: {"source": stored(writer, data)}}}
    if fallback:
        source["source"] = stored(writer, encoded(np.zeros((1, 1, 3))))
    writer.json["extensionsRequired"] = [extension]
    show(writer, **source)
    scene = writer.load(strict=True)
    assert (first_pixel(scene), scene.warnings) == (pixel, [])


def test_a_damaged_image_leaves_the_factor(writer):
    slots = ("baseColorTexture", "metallicRoughnessTexture", "normalTexture", "emissiveTexture")
    show(writer, *slots, source=stored(writer, encoded(NOISE)[:99], name="bark"))
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
        ({"uri": "notes.txt"}, r"image 0 (notes.txt) is not a PNG, JPEG, WebP or KTX2 image"),
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
    compressed = {"extensions": {"KHR_texture_basisu": {"source": stored(writer, ktx2_files.ETC1S)}}}
    show(writer, source=stored(writer, encoded(BLUE)), **compressed)
    with pytest.warns(UserWarning, match="Basis Universal.*pip install 'solari-vk") as warned:
        scene = writer.load()
    assert first_pixel(scene) == [20, 40, 220, 255]
    assert [str(one.message) for one in warned] == scene.warnings
