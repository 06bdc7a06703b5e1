"""The data that load_gltf reads: packings of the format, accessors, triangles, normals."""

from __future__ import annotations

import numpy as np
import pytest
from support.files import TRIANGLE

from solari_vk.scene.files.gltf import load_gltf


def load_mesh(writer):
    """The mesh that load_gltf makes of a writer's only mesh."""
    (instance,) = writer.load()
    return instance.mesh


def corners(mesh):
    return mesh.positions[mesh.triangles].tolist()


# ---- files and accessors ----------------------------------------------------------------------------


@pytest.mark.parametrize("packing", ["glb", "embedded", "external"])
def test_packings_give_the_same_scene(tmp_path, writer, packing):
    writer.mesh(indices=[0, 1, 2])
    writer.node(mesh=0, name="arm")
    path = writer.save(tmp_path / ("with space.glb" if packing == "glb" else "with space.gltf"), packing)
    if packing == "external":  # percent-encoded, as the format asks
        path.write_text(path.read_text().replace("with space.bin", "with%20space.bin"))
    scene = load_gltf(path)
    (instance,) = scene
    assert (instance.name, scene.warnings, scene.name) == ("arm", [], "with space")
    assert corners(instance.mesh) == [TRIANGLE]


def test_the_kind_of_file_is_seen_from_its_content_and_names_need_no_encoding(tmp_path, writer):
    writer.mesh()
    assert len(load_gltf(writer.save(tmp_path / "binary.gltf")).instances) == 1
    assert len(load_gltf(str(writer.save(tmp_path / "100%25 #1.gltf", "external"))).instances) == 1


@pytest.mark.parametrize(("dtype", "stride"), [("u1", None), ("u2", 16), ("u4", 252)])
def test_indices_of_every_type_and_vertices_of_any_stride(writer, dtype, stride):
    position = writer.accessor([[9, 9, 9], *TRIANGLE], stride=stride)
    writer.mesh({"POSITION": position}, writer.accessor([3, 1, 2], dtype))
    mesh = load_mesh(writer)
    assert corners(mesh) == [[TRIANGLE[2], TRIANGLE[0], TRIANGLE[1]]]
    assert len(mesh.positions) == 3, "vertices that no triangle uses are not kept"


@pytest.mark.parametrize("dtype", ["i1", "i2", "u1", "u2"])
@pytest.mark.parametrize("normalized", [False, True])
def test_quantized_positions(writer, dtype, normalized):
    given = np.array([[0, 0, 0], [100, 0, 0], [0, 100, 50]])
    if dtype[0] == "i":
        given[2] = [-100, 3, np.iinfo(dtype).min]
    writer.mesh({"POSITION": writer.accessor(given, dtype, stride=8, **({"normalized": True} if normalized else {}))})
    writer.json["extensionsRequired"] = writer.json["extensionsUsed"] = ["KHR_mesh_quantization"]
    expected = np.maximum(given / np.iinfo(dtype).max, -1) if normalized else given
    np.testing.assert_allclose(load_mesh(writer).positions, expected, rtol=1e-6)


@pytest.mark.parametrize(("based", "dtype"), [(True, "u1"), (False, "u2"), (False, "u4")])
def test_sparse_accessors(writer, based, dtype):
    number = writer.accessor([[0, 0, 0], [5, 5, 5], [0, 1, 0]])
    accessor = writer.json["accessors"][number]
    if not based:  # a sparse accessor without a buffer view starts with zeros
        del accessor["bufferView"]
    replaced = {1: [1.0, 0, 0]} if based else {1: [1.0, 0, 0], 2: [0, 1.0, 0]}
    accessor["sparse"] = {
        "count": len(replaced),
        "indices": {
            "bufferView": writer.view(np.array(list(replaced), dtype).tobytes()),
            "componentType": {"u1": 5121, "u2": 5123, "u4": 5125}[dtype],
        },
        "values": {"bufferView": writer.view(np.array(list(replaced.values()), "<f4").tobytes())},
    }
    writer.mesh({"POSITION": number})
    assert corners(load_mesh(writer)) == [TRIANGLE]


def test_unaligned_and_interleaved_data(writer):
    rows = np.zeros(3, [("pad", "u1"), ("position", "<f4", 3), ("uv", "<u2", 2), ("end", "u1", 3)])
    rows["position"], rows["uv"] = TRIANGLE, [[0, 0], [65535, 0], [0, 65535]]
    fields = {"bufferView": writer.view(rows.tobytes(), byteStride=rows.itemsize), "count": 3}
    position = writer.add("accessors", byteOffset=1, componentType=5126, type="VEC3", **fields)
    uv = writer.add("accessors", byteOffset=13, componentType=5123, type="VEC2", normalized=True, **fields)
    writer.mesh({"POSITION": position, "TEXCOORD_0": uv})
    mesh = load_mesh(writer)
    assert corners(mesh) == [TRIANGLE]
    assert mesh.uvs.tolist() == [[0, 0], [1, 0], [0, 1]]


# ---- triangles --------------------------------------------------------------------------------------

FIVE = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [-1, 0, 0]]


def with_area(triangles):
    return [t for t in triangles if np.cross(np.subtract(t[1], t[0]), np.subtract(t[2], t[0])).any()]


@pytest.mark.parametrize(
    ("mode", "expected"),
    [
        (4, [[0, 1, 2], [3, 4, 0]]),
        (5, [[0, 1, 2], [1, 3, 2], [2, 3, 4], [3, 0, 4]]),
        (6, [[1, 2, 0], [2, 3, 0], [3, 4, 0]]),
    ],
)
@pytest.mark.parametrize("indexed", [True, False])
def test_triangle_modes(writer, mode, expected, indexed):
    order = [0, 1, 2, 3, 4, 0]
    if indexed:
        writer.mesh({"POSITION": FIVE}, order, mode=mode)
    else:
        writer.mesh({"POSITION": [FIVE[i] for i in order]}, mode=mode)
    # The last triangle of the fan repeats its first vertex: it has no area, and is dropped.
    assert with_area(corners(load_mesh(writer))) == with_area([[FIVE[i] for i in t] for t in expected])


@pytest.mark.parametrize(
    ("mesh", "triangle_count", "remark"),
    [
        ({"attributes": {"POSITION": [[n] * 3 for n in range(3)]}}, 0, "primitives without any triangle of some area"),
        ({"attributes": {"POSITION": None}}, 0, "primitives without POSITION are left out"),
        ({"indices": [0, 1, 2, 0]}, 1, "the last corners make no whole triangle and are left out"),
    ],
)
def test_primitives_without_a_surface_and_incomplete_triangles_are_reported(writer, mesh, triangle_count, remark):
    writer.mesh(**mesh)
    scene = writer.load()
    [warning] = scene.warnings
    assert warning.startswith(remark)
    assert warning.endswith(": mesh 0, primitive 0")
    assert sum(len(instance.mesh.triangles) for instance in scene) == triangle_count


def test_normals_are_made_unit_and_missing_ones_are_flat(writer):
    writer.mesh({"NORMAL": [[0, 0, 2], [0, 0, 1], [0, 0, 0]]})
    writer.mesh({"TANGENT": [[1, 0, 0, 1]] * 3})
    scene = writer.load()
    first, second = (instance.mesh for instance in scene)
    assert first.normals.tolist() == [[0, 0, 1]] * 3
    assert "zero length" in scene.warnings[0]
    assert second.normals is None
    assert second.tangents is None, "tangents without normals have no meaning"
