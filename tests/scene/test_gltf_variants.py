"""KHR_materials_variants: the materials of a file's variants, by name."""

from __future__ import annotations

import numpy as np
import pytest

from solari_vk.base.errors import SolariError

NAME = "KHR_materials_variants"
UVS = [[0, 0], [1, 0], [0, 1]]


@pytest.fixture
def shoes(writer):
    """Two meshes: the first has another material in two of three variants, the second has always the same."""
    for name in ("leather", "red", "blue"):
        writer.add("materials", name=name)
    writer.json["materials"][2]["normalTexture"] = {"index": writer.image(np.full((2, 2, 3), 128))}
    mappings = [{"material": 1, "variants": [0]}, {"material": 2, "variants": [2]}]
    extension = {"extensions": {NAME: {"mappings": mappings}}}
    writer.mesh({"TEXCOORD_0": UVS, "NORMAL": [[0, 0, 1]] * 3}, material=0, **extension)
    writer.mesh({"POSITION": [[0, 0, 0], [2, 0, 0], [0, 2, 0]]}, material=0)
    writer.json["extensions"] = {NAME: {"variants": [{"name": "Red"}, {"name": "Plain"}, {"name": "Blue"}]}}
    writer.json["extensionsUsed"] = writer.json["extensionsRequired"] = [NAME]
    return writer


def names(scene):
    return [instance.material.name for instance in scene]


def test_variants_by_name(shoes):
    scene = shoes.load()
    assert scene.warnings == []
    assert list(scene.variants) == ["Red", "Plain", "Blue"]
    assert names(scene) == ["leather", "leather"]
    for variant, material in (("Red", "red"), ("Blue", "blue"), ("Plain", "leather"), ("Blue", "blue")):
        scene.use_variant(variant)
        assert names(scene) == [material, "leather"]
    assert scene.instances[0].mesh.tangents is not None, "made for the normal map of one of the variants"
    scene.use_variant(None)
    assert names(scene) == ["leather", "leather"]
    first, second = scene.instances
    scene.variants["swapped"] = {second: scene.variants["Red"][first]}
    scene.use_variant("swapped")
    assert names(scene) == ["leather", "red"]
    red = shoes.load(variant="Red")
    assert names(red) == ["red", "leather"]
    red.use_variant(None)
    assert names(red) == ["leather", "leather"]


def test_unknown_variants(shoes):
    with pytest.raises(SolariError, match=r"file\.glb: there is no variant 'red'; did you mean 'Red'"):
        shoes.load(variant="red")
    del shoes.json["extensions"], shoes.json["meshes"][0]["primitives"][0]["extensions"]
    with pytest.raises(SolariError, match="there are none"):
        shoes.load(variant="Red")


def test_wrong_mappings(shoes):
    mappings = shoes.json["meshes"][0]["primitives"][0]["extensions"][NAME]["mappings"]
    instances = len(shoes.load().instances)
    for mapping, message in (
        ({"material": 0, "variants": [3]}, "refers to variant 3, but the file has only 3"),
        ({"material": 9, "variants": [0]}, "refers to material 9"),
        ({"variants": [0]}, "'material' is missing"),
        ({"material": 0, "variants": "all"}, "a list of whole numbers"),
    ):
        mappings[:] = [mapping]
        assert len(shoes.load_with_loss(message).instances) == instances


def test_names_are_made_where_the_file_has_none_or_the_same_twice(shoes):
    shoes.json["extensions"][NAME]["variants"] = [{"name": "a"}, {"name": "a"}, {}]
    assert list(shoes.load().variants) == ["a", "a (1)", "variant 2"]
