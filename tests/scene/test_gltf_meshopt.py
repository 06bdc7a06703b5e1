"""Buffer views compressed by meshopt give the meshes of plain files; damaged and hostile ones give an error."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from support.compressed_gltf import MESHOPT, SIDE, corners, meshopt_accessor, meshopt_file, plain_file, wave
from support.gltf_writer import GltfWriter

from solari_vk.errors import SolariError


@pytest.mark.parametrize("extension", MESHOPT)
def test_the_mesh_is_that_of_a_plain_file(tmp_path, writer, extension):
    meshopt_file(writer, extension)
    scene = writer.load(strict=True)
    assert scene.warnings == []
    plain = GltfWriter(tmp_path / "plain.glb")
    plain_file(plain)
    found, expected = corners(scene), corners(plain.load())
    np.testing.assert_allclose(found[:, :3], expected[:, :3], atol=2e-5)
    np.testing.assert_allclose(found[:, 3:6], expected[:, 3:6], atol=0.02)
    np.testing.assert_allclose(found[:, 6:], expected[:, 6:], atol=1e-6)


def test_sequences_of_indices(writer):
    strip = np.array([0, SIDE, 1, SIDE + 1, 2, SIDE + 2], np.uint32)
    indices = meshopt_accessor(writer, strip, "u4", "SCALAR", "INDICES")
    writer.mesh({"POSITION": wave()[0]}, indices, mode=5)
    writer.finish()["buffers"].append({"byteLength": 24})
    assert writer.load().instances[0].mesh.triangles.shape == (4, 3)


@pytest.mark.parametrize(
    ("view", "fields", "message"),
    [(0, {"count": 2**40}, "MiB large although"), (0, {"count": 200}, "damaged data"),
     (0, {"byteStride": 10}, "damaged data"), (0, {"byteStride": 300}, "from 1 to 256"),
     (0, {"mode": "POINTS"}, "one of ATTRIBUTES"), (0, {"filter": "X"}, "one of NONE"),
     (0, {"filter": "OCTAHEDRAL"}, "damaged data"), (0, {"byteLength": 2**30}, "reaches from byte"),
     (0, {"byteLength": 20}, "damaged data"), (0, {"buffer": 7}, "refers to buffer"),
     (3, {"count": 3}, "damaged data|says more bytes than"), (3, {"byteStride": 1}, "damaged data")],
)  # fmt: skip
def test_damaged_data(writer, view, fields, message):
    meshopt_file(writer)
    views = [view for view in writer.json["bufferViews"] if "extensions" in view]
    views[view]["extensions"][MESHOPT[0]] |= fields
    with pytest.raises(SolariError, match=message) as caught:
        writer.load()
    assert str(caught.value).startswith(f"{writer.path}: bufferView")


def test_views_with_plain_data_too_need_no_library(writer, monkeypatch):
    meshopt_file(writer)
    monkeypatch.setattr("solari_vk.scene.libraries.is_installed", lambda module: False)
    monkeypatch.setitem(sys.modules, "meshopt", None)
    with pytest.raises(SolariError, match=r"needs a library .*pip install 'solari-vk\[formats\]'"):
        writer.load()
    positions, normals, uvs, triangles = wave()
    contents = positions.astype("<f4"), np.zeros((len(normals), 4), "i1"), uvs.astype("<f4"), triangles.astype("<u2")
    data = bytearray()
    views = [view for view in writer.json["bufferViews"] if "extensions" in view]
    for view, content in zip(views, contents, strict=True):
        view["byteOffset"] = len(data)
        data += content.tobytes()
    writer.json["buffers"][1] = {"byteLength": len(data), "uri": "plain.bin"}
    (writer.path.parent / "plain.bin").write_bytes(data)
    np.testing.assert_allclose(writer.load().instances[0].mesh.positions, positions, atol=1e-6)
