"""Images of glTF files: all formats, and images that can't be read, which cost their texture and not the model."""

from __future__ import annotations

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
SLOTS = ("baseColorTexture", "metallicRoughnessTexture", "normalTexture", "emissiveTexture")


def material_with(writer, slot, texture):
    """The writer's triangle with a material that has a texture in a slot, loaded."""
    holder = {slot: {"index": texture}}
    fields = {"pbrMetallicRoughness": holder} if slot in SLOTS[:2] else holder
    writer.mesh({"TEXCOORD_0": [[0, 0], [1, 0], [0, 1]]}, material=writer.add("materials", **fields))


def stored(writer, data, **fields):
    """The number of an image with these bytes."""
    return writer.add("images", bufferView=writer.view(data), **fields)


@pytest.mark.parametrize(
    ("extension", "data"),
    [("EXT_texture_webp", encoded(BLUE, "WEBP", lossless=True)), ("KHR_texture_basisu", ktx2_files.UASTC)],
)
@pytest.mark.parametrize("fallback", [False, True])
def test_images_of_extensions_come_before_those_that_replace_them(writer, extension, data, fallback):
    source = {"extensions": {extension: {"source": stored(writer, data)}}}
    if fallback:
        source["source"] = stored(writer, encoded(np.zeros((1, 1, 3))))
    writer.json["extensionsRequired"] = [extension]
    material_with(writer, "emissiveTexture", writer.add("textures", **source))
    scene = writer.load(strict=True)
    assert scene.warnings == []
    pixel = scene.instances[0].material.emissive_texture.image.pixels[0, 0]
    assert pixel.tolist() == [20, 40, 220, 255] if "webp" in extension else [200, 40, 40, 255]


@pytest.mark.parametrize("slot", SLOTS)
def test_a_damaged_image_leaves_the_factor(writer, slot):
    material_with(writer, slot, writer.add("textures", source=stored(writer, encoded(NOISE)[:99], name="bark")))
    scene = writer.load()
    (instance,) = scene
    assert all(getattr(instance.material, name) is None for name in TEXTURES)
    [warning] = scene.warnings
    assert warning.startswith(LEFT_OUT + "image 0 'bark' is a damaged image")
    with pytest.raises(SolariError, match=r"file\.glb: image 0 'bark' is a damaged image"):
        writer.load(strict=True)


@pytest.mark.parametrize(
    ("image", "reason"),
    [({"uri": "wood%20grain.png"}, "image 0 needs the file 'wood%20grain.png', which is not beside the glTF file"),
     ({"uri": "notes.txt"}, r"image 0 (notes.txt) is not a PNG, JPEG, WebP or KTX2 image"),
     ({"uri": "data:;base64,####"}, "image 0 has a data URI that is not valid base64"),
     ({"bufferView": 99}, "image 0 refers to bufferView 99"), ({}, "image 0 has a wrong field: 'bufferView'")],
)  # fmt: skip
def test_images_that_can_not_be_read_are_named(writer, image, reason):
    (writer.path.parent / "notes.txt").write_text("no picture")
    material_with(writer, "emissiveTexture", writer.add("textures", source=writer.add("images", **image)))
    scene = writer.load()
    assert scene.instances[0].material.emissive_texture is None
    assert scene.warnings[0].startswith(LEFT_OUT + reason)
    with pytest.raises(SolariError):
        writer.load(strict=True)


def test_another_image_replaces_one_that_needs_a_missing_library(writer, monkeypatch):
    monkeypatch.setitem(sys.modules, "opengl_basisu", None)
    source = {"extensions": {"KHR_texture_basisu": {"source": stored(writer, ktx2_files.ETC1S)}}}
    material_with(writer, "emissiveTexture", writer.add("textures", source=stored(writer, encoded(BLUE)), **source))
    scene = writer.load()
    assert scene.instances[0].material.emissive_texture.image.pixels[0, 0].tolist() == [20, 40, 220, 255]
    assert "pip install 'solari-vk[formats]'" in scene.warnings[0]
