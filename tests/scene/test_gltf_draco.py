"""Primitives compressed by Draco give the meshes of plain files; damaged and hostile ones give an error."""

from __future__ import annotations

import sys

import DracoPy
import numpy as np
import pytest
from support.compressed_gltf import corners, draco_file, plain_file
from support.gltf_writer import GltfWriter

from solari_vk.errors import SolariError


@pytest.fixture
def expected(tmp_path):
    """The corners of the plain file."""
    writer = GltfWriter(tmp_path / "plain.glb")
    plain_file(writer)
    return corners(writer.load())


@pytest.mark.parametrize("options", [{}, {"preserve_order": True}, {"names": ["x"], "create_metadata": True}])
def test_the_mesh_is_that_of_a_plain_file(expected, writer, options):
    draco_file(writer, **options)
    found = corners(writer.load(strict=True))
    np.testing.assert_allclose(found[:, :3], expected[:, :3], atol=3e-5)
    np.testing.assert_allclose(found[:, 3:6], expected[:, 3:6], atol=0.01)
    np.testing.assert_allclose(found[:, 6:], expected[:, 6:], atol=1e-3)


def claim(number):
    """A change of compressed data: they say to have another number of triangles."""

    def changed(packed):
        assert packed[8] == 1, "compressed by edgebreaker: its kind and the number of vertices come first"
        return packed[:14] + number + packed[16:]

    return changed


@pytest.mark.parametrize(
    ("change", "message"),
    [(lambda packed: b"DRACO", "no Draco mesh of version 2.2"), (lambda packed: packed[:99], "damaged data"),
     (lambda packed: DracoPy.encode(np.eye(3)), "no Draco mesh"), (claim(b"\xff" * 99), "no Draco mesh"),
     (claim(b"\xff\xff\xff\xff\x03"), "MiB large although"), (claim(b"\xff\x01"), "damaged data")],
)  # fmt: skip
def test_damaged_data(writer, change, message):
    draco_file(writer, change)
    with pytest.raises(SolariError, match=message):
        writer.load()


@pytest.mark.parametrize(
    ("fields", "message"),
    [({"attributes": {"POSITION": 99}}, "names the attribute 99 for POSITION"),
     ({"attributes": {"TEXCOORD_0": 3}}, "has 2 components, but the data of"),
     ({"bufferView": 9}, "refers to bufferView 9")],
)  # fmt: skip
def test_wrong_references(writer, fields, message):
    extension = draco_file(writer)
    extension |= fields
    with pytest.raises(SolariError, match=message):
        writer.load()


def test_primitives_with_the_same_accessors_have_their_own_data(writer):
    def doubled(packed):
        mesh = DracoPy.decode(packed)
        arrays = {attribute["unique_id"]: attribute["data"] for attribute in mesh.attributes}
        return DracoPy.encode(2 * mesh.points, mesh.faces, quantization_bits=16, normals=mesh.normals.astype(float),
                              tex_coord=mesh.tex_coord.astype(float), generic_attributes={3: arrays[3]})  # fmt: skip

    draco_file(writer)
    draco_file(writer, doubled)
    first, second = (mesh["primitives"][0] for mesh in writer.json["meshes"])
    second |= {name: first[name] for name in ("attributes", "indices")}
    low, high = (instance.mesh.positions.max() for instance in writer.load())
    assert (low, high) == pytest.approx((1, 2), rel=1e-3)


def test_data_that_the_accessor_can_not_hold(writer):
    draco_file(writer)
    colors = writer.json["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]
    writer.json["accessors"][colors]["componentType"] = 5121
    with pytest.raises(SolariError, match="has uint8 values, which are too narrow"):
        writer.load()


def test_attributes_are_needed(writer):
    del draco_file(writer)["attributes"]
    with pytest.raises(SolariError, match="needs 'indices', and 'attributes'"):
        writer.load()


def test_primitives_with_plain_data_too_need_no_library(expected, tmp_path, writer, monkeypatch):
    draco_file(writer)
    monkeypatch.setattr("solari_vk.scene.libraries.is_installed", lambda module: False)
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    with pytest.raises(SolariError, match=r"needs a library .*pip install 'solari-vk\[formats\]'"):
        writer.load()
    both = GltfWriter(tmp_path / "both.glb")
    draco_file(both, plain=True)
    np.testing.assert_allclose(corners(both.load()), expected, atol=1e-6)
