"""Data compressed by meshopt and Draco give the meshes of plain files; damaged and hostile ones give an error."""

from __future__ import annotations

import sys

import DracoPy
import numpy as np
import pytest
from support.files import (
    MESHOPT,
    SHEET_SIDE,
    GltfWriter,
    corners,
    draco_file,
    meshopt_accessor,
    meshopt_file,
    plain_file,
    wavy_sheet,
)

from solari_vk.base.errors import SolariError


@pytest.fixture
def expected(tmp_path):
    """The corners of the plain file."""
    writer = GltfWriter(tmp_path / "plain.glb")
    plain_file(writer)
    return corners(writer.load())


@pytest.fixture
def no_library(monkeypatch):
    monkeypatch.setattr("solari_vk.scene.files.libraries.is_installed", lambda module: False)
    for module in ("meshopt", "DracoPy"):
        monkeypatch.setitem(sys.modules, module, None)


def check_sheet(scene, expected, atol):
    """Compare positions, normals and uvs with those of the plain file."""
    assert scene.warnings == []
    for columns, limit in zip((slice(0, 3), slice(3, 6), slice(6, 8)), atol, strict=True):
        np.testing.assert_allclose(corners(scene)[:, columns], expected[:, columns], atol=limit)


# ---- meshopt ----------------------------------------------------------------------------------------


def compressed_views(writer):
    return [view for view in writer.json["bufferViews"] if "extensions" in view]


@pytest.mark.parametrize("extension", MESHOPT)
def test_meshopt(writer, expected, extension):
    meshopt_file(writer, extension)
    check_sheet(writer.load(strict=True), expected, (2e-5, 0.02, 1e-6))


def test_sequences_of_indices(writer):
    strip = np.array([0, SHEET_SIDE, 1, SHEET_SIDE + 1, 2, SHEET_SIDE + 2], np.uint32)
    indices = meshopt_accessor(writer, strip, "u4", "SCALAR", "INDICES")
    writer.mesh({"POSITION": wavy_sheet()[0]}, indices, mode=5)
    writer.finish()["buffers"].append({"byteLength": 24})
    assert writer.load().instances[0].mesh.triangles.shape == (4, 3)


@pytest.mark.parametrize(
    ("view", "fields", "message"),
    [
        (0, {"count": 2**40}, "MiB large although"),
        (0, {"count": 200}, "damaged data"),
        (0, {"byteStride": 10}, "damaged data"),
        (0, {"byteStride": 300}, "from 1 to 256"),
        (0, {"mode": "POINTS"}, "one of ATTRIBUTES"),
        (0, {"filter": "X"}, "one of NONE"),
        (0, {"filter": "OCTAHEDRAL"}, "damaged data"),
        (0, {"byteLength": 2**30}, "reaches from byte"),
        (0, {"byteLength": 20}, "damaged data"),
        (0, {"buffer": 7}, "refers to buffer"),
        (3, {"count": 3}, "(damaged data|says more bytes than)"),
        (3, {"byteStride": 1}, "damaged data"),
    ],
)
def test_damaged_meshopt(writer, view, fields, message):
    meshopt_file(writer)
    compressed_views(writer)[view]["extensions"][MESHOPT[0]] |= fields
    with pytest.raises(SolariError, match=rf"file\.glb: bufferView.*{message}"):
        writer.load()


def test_views_with_plain_data_too_need_no_library(writer, no_library):
    meshopt_file(writer)
    with pytest.raises(SolariError, match=r"needs a library .*pip install 'solari-vk\[formats\]'"):
        writer.load()
    positions, normals, uvs, triangles = wavy_sheet()
    contents = positions.astype("<f4"), np.zeros((len(normals), 4), "i1"), uvs.astype("<f4"), triangles.astype("<u2")
    data = bytearray()
    for view, content in zip(compressed_views(writer), contents, strict=True):
        view["byteOffset"] = len(data)
        data += content.tobytes()
    writer.json["buffers"][1] = {"byteLength": len(data), "uri": "plain.bin"}
    (writer.path.parent / "plain.bin").write_bytes(data)
    np.testing.assert_allclose(writer.load().instances[0].mesh.positions, positions, atol=1e-6)


# ---- Draco ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("options", [{}, {"preserve_order": True}, {"names": ["x"], "create_metadata": True}])
def test_draco(writer, expected, options):
    draco_file(writer, **options)
    check_sheet(writer.load(strict=True), expected, (3e-5, 0.01, 1e-3))


def claim(number):
    """A change of compressed data: they say to have another number of triangles."""

    def changed(packed):
        assert packed[8] == 1, "compressed by edgebreaker: its kind and the number of vertices come first"
        return packed[:14] + number + packed[16:]

    return changed


@pytest.mark.parametrize(
    ("change", "fields", "message"),
    [
        (lambda packed: b"DRACO", {}, "no Draco mesh of version 2.2"),
        (lambda packed: packed[:99], {}, "damaged data"),
        (lambda packed: DracoPy.encode(np.eye(3)), {}, "no Draco mesh"),
        (claim(b"\xff" * 99), {}, "no Draco mesh"),
        (claim(b"\xff\xff\xff\xff\x03"), {}, "MiB large although"),
        (claim(b"\xff\x01"), {}, "damaged data"),
        (bytes, {"attributes": {"POSITION": 99}}, "names the attribute 99 for POSITION"),
        (bytes, {"attributes": {"TEXCOORD_0": 3}}, "has 2 components, but the data of"),
        (bytes, {"attributes": None}, "needs 'indices', and 'attributes'"),
        (bytes, {"bufferView": 9}, "refers to bufferView 9"),
    ],
)
def test_damaged_draco(writer, change, fields, message):
    extension = draco_file(writer, change)
    extension |= fields
    if extension["attributes"] is None:
        del extension["attributes"]
    with pytest.raises(SolariError, match=message):
        writer.load()


def test_data_that_the_accessor_can_not_hold(writer):
    draco_file(writer)
    colors = writer.json["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]
    writer.json["accessors"][colors]["componentType"] = 5121
    with pytest.raises(SolariError, match="has uint8 values, which are too narrow"):
        writer.load()


def test_primitives_with_the_same_accessors_have_their_own_data(writer):
    def doubled(packed):
        mesh = DracoPy.decode(packed)
        arrays = {attribute["unique_id"]: attribute["data"] for attribute in mesh.attributes}
        return DracoPy.encode(
            2 * mesh.points,
            mesh.faces,
            quantization_bits=16,
            normals=mesh.normals.astype(float),
            tex_coord=mesh.tex_coord.astype(float),
            generic_attributes={3: arrays[3]},
        )

    draco_file(writer)
    draco_file(writer, doubled)
    first, second = (mesh["primitives"][0] for mesh in writer.json["meshes"])
    second |= {name: first[name] for name in ("attributes", "indices")}
    low, high = (instance.mesh.positions.max() for instance in writer.load())
    assert (low, high) == pytest.approx((1, 2), rel=1e-3)


def test_primitives_with_plain_data_too_need_no_library(expected, tmp_path, writer, no_library):
    draco_file(writer)
    both = GltfWriter(tmp_path / "both.glb")
    draco_file(both, plain=True)
    with pytest.raises(SolariError, match=r"needs a library .*pip install 'solari-vk\[formats\]'"):
        writer.load()
    np.testing.assert_allclose(corners(both.load()), expected, atol=1e-6)
