"""The data that load_gltf reads: packings of the format, accessors, triangles, normals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gltf_writer import TRIANGLE, GltfWriter

from solari_vk.scene.gltf import load_gltf
from solari_vk.scene.model import Mesh, Scene


def load(writer: GltfWriter, tmp_path: Path, **options: Any) -> Scene:
    return load_gltf(writer.save(tmp_path / "file.glb"), **options)


def load_mesh(writer: GltfWriter, tmp_path: Path) -> Mesh:
    """The mesh that load_gltf makes of a writer's last mesh."""
    writer.node(mesh=len(writer.json["meshes"]) - 1)
    (instance,) = load(writer, tmp_path)
    return instance.mesh


def corners(mesh: Mesh) -> list[list[list[float]]]:
    return mesh.positions[mesh.triangles].tolist()


# ---- files and accessors ----------------------------------------------------------------------------


@pytest.mark.parametrize("packing", ["glb", "embedded", "external"])
def test_packings_give_the_same_scene(tmp_path: Path, packing: str) -> None:
    writer = GltfWriter()
    writer.mesh(indices=[0, 1, 2])
    writer.node(mesh=0, name="arm")
    name = "with space.glb" if packing == "glb" else "with space.gltf"
    path = writer.save(tmp_path / name, packing)
    if packing == "external":  # percent-encoded, as the format asks
        path.write_text(path.read_text().replace("with space.bin", "with%20space.bin"))
    scene = load_gltf(path)
    (instance,) = scene
    assert (instance.name, scene.warnings, scene.name) == ("arm", [], "with space")
    assert corners(instance.mesh) == [TRIANGLE]


def test_the_kind_of_file_is_seen_from_its_content_and_names_need_no_encoding(tmp_path: Path) -> None:
    writer = GltfWriter()
    writer.mesh()
    writer.node(mesh=0)
    assert len(load_gltf(writer.save(tmp_path / "binary.gltf")).instances) == 1
    path = writer.save(tmp_path / "100%25 #1.gltf", "external")
    assert len(load_gltf(str(path)).instances) == 1


@pytest.mark.parametrize("dtype", ["u1", "u2", "u4"])
@pytest.mark.parametrize("stride", [None, 16, 252])
def test_indices_of_every_type_and_vertices_of_any_stride(tmp_path: Path, dtype: str, stride: int | None) -> None:
    writer = GltfWriter()
    position = writer.accessor([[9, 9, 9], *TRIANGLE], stride=stride)
    writer.mesh({"POSITION": position}, writer.accessor([3, 1, 2], dtype))
    mesh = load_mesh(writer, tmp_path)
    assert corners(mesh) == [[TRIANGLE[2], TRIANGLE[0], TRIANGLE[1]]]
    assert len(mesh.positions) == 3, "vertices that no triangle uses are not kept"


@pytest.mark.parametrize(
    ("dtype", "normalized", "scale"),
    [("i1", True, 127), ("i2", True, 32767), ("i1", False, 1), ("i2", False, 1), ("u1", True, 255), ("u2", True, 65535),
     ("u1", False, 1), ("u2", False, 1)],
)  # fmt: skip
def test_quantized_positions(tmp_path: Path, dtype: str, normalized: bool, scale: float) -> None:
    writer = GltfWriter()
    given = np.array([[0, 0, 0], [100, 0, 0], [0, 100, 50]])
    if dtype[0] == "i":
        given[2] = [-100, 3, np.iinfo(dtype).min]
    extra = {"normalized": True} if normalized else {}
    writer.mesh({"POSITION": writer.accessor(given, dtype, stride=8, **extra)})
    writer.json["extensionsRequired"] = writer.json["extensionsUsed"] = ["KHR_mesh_quantization"]
    expected = np.maximum(given / scale, -1) if normalized else given
    np.testing.assert_allclose(load_mesh(writer, tmp_path).positions, expected, rtol=1e-6)


@pytest.mark.parametrize("based", [True, False])
@pytest.mark.parametrize("dtype", ["u1", "u2", "u4"])
def test_sparse_accessors(tmp_path: Path, based: bool, dtype: str) -> None:
    writer = GltfWriter()
    number = writer.accessor([[0, 0, 0], [5, 5, 5], [0, 1, 0]])
    accessor = writer.json["accessors"][number]
    if not based:  # a sparse accessor without a buffer view starts with zeros
        del accessor["bufferView"]
    replaced = {1: [1.0, 0, 0]} if based else {1: [1.0, 0, 0], 2: [0, 1.0, 0]}
    accessor["sparse"] = {
        "count": len(replaced),
        "indices": {"bufferView": writer.view(np.array(list(replaced), dtype).tobytes()),
                    "componentType": {"u1": 5121, "u2": 5123, "u4": 5125}[dtype]},
        "values": {"bufferView": writer.view(np.array(list(replaced.values()), "<f4").tobytes())},
    }  # fmt: skip
    writer.mesh({"POSITION": number})
    assert corners(load_mesh(writer, tmp_path)) == [TRIANGLE]


def test_unaligned_and_interleaved_data(tmp_path: Path) -> None:
    writer = GltfWriter()
    rows = np.zeros(3, [("pad", "u1"), ("position", "<f4", 3), ("uv", "<u2", 2), ("end", "u1", 3)])
    rows["position"], rows["uv"] = TRIANGLE, [[0, 0], [65535, 0], [0, 65535]]
    view = writer.view(rows.tobytes(), byteStride=rows.itemsize)
    position = writer.add("accessors", bufferView=view, byteOffset=1, componentType=5126, count=3, type="VEC3")
    uv = writer.add(
        "accessors", bufferView=view, byteOffset=13, componentType=5123, count=3, type="VEC2", normalized=True
    )
    writer.mesh({"POSITION": position, "TEXCOORD_0": uv})
    mesh = load_mesh(writer, tmp_path)
    assert corners(mesh) == [TRIANGLE]
    assert mesh.uvs is not None
    assert mesh.uvs.tolist() == [[0, 0], [1, 0], [0, 1]]


# ---- triangles --------------------------------------------------------------------------------------

FIVE = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [-1, 0, 0]]


@pytest.mark.parametrize(
    ("mode", "expected"),
    [(4, [[0, 1, 2], [3, 4, 0]]), (5, [[0, 1, 2], [1, 3, 2], [2, 3, 4], [3, 0, 4]]),
     (6, [[1, 2, 0], [2, 3, 0], [3, 4, 0]])],
)  # fmt: skip
@pytest.mark.parametrize("indexed", [True, False])
def test_triangle_modes(tmp_path: Path, mode: int, expected: list[list[int]], indexed: bool) -> None:
    writer = GltfWriter()
    order = [0, 1, 2, 3, 4, 0]
    if indexed:
        writer.mesh({"POSITION": FIVE}, order, mode=mode)
    else:
        writer.mesh({"POSITION": [FIVE[i] for i in order]}, mode=mode)
    # The last triangle of the fan repeats its first vertex: it has no area, and is dropped.
    mesh = load_mesh(writer, tmp_path)
    found = [t for t in corners(mesh) if np.cross(np.subtract(t[1], t[0]), np.subtract(t[2], t[0])).any()]
    wanted = [[FIVE[i] for i in t] for t in expected]
    assert found == [t for t in wanted if np.cross(np.subtract(t[1], t[0]), np.subtract(t[2], t[0])).any()]


@pytest.mark.parametrize(("mode", "name"), [(0, "points"), (1, "lines"), (2, "line loops"), (3, "line strips")])
def test_points_and_lines_are_reported(tmp_path: Path, mode: int, name: str) -> None:
    writer = GltfWriter()
    writer.mesh(mode=mode)
    writer.node(mesh=0)
    scene = load(writer, tmp_path)
    assert not scene.instances
    assert scene.warnings == [f"{name} have no surface and are left out: mesh 0, primitive 0"]


@pytest.mark.parametrize(
    ("mesh", "warning"),
    [({"POSITION": [[0, 0, 0], [1, 1, 1], [2, 2, 2]]}, "without any triangle of some area"),
     ({"POSITION": [[1, 2, 3]] * 3}, "without any triangle of some area"),
     ({"POSITION": None}, "without POSITION")],
)  # fmt: skip
def test_primitives_without_surface_are_reported(tmp_path: Path, mesh: dict[str, Any], warning: str) -> None:
    writer = GltfWriter()
    writer.mesh(mesh)
    writer.node(mesh=0)
    scene = load(writer, tmp_path)
    assert not scene.instances
    assert len(scene.warnings) == 1
    assert warning in scene.warnings[0]


def test_incomplete_triangles_are_reported(tmp_path: Path) -> None:
    writer = GltfWriter()
    writer.mesh(indices=[0, 1, 2, 0])
    writer.node(mesh=0)
    scene = load(writer, tmp_path)
    assert "whole triangle" in scene.warnings[0]
    assert len(next(iter(scene)).mesh.triangles) == 1


def test_normals_are_made_unit_and_missing_ones_are_flat(tmp_path: Path) -> None:
    writer = GltfWriter()
    writer.mesh({"NORMAL": [[0, 0, 2], [0, 0, 1], [0, 0, 0]]})
    writer.mesh({"TANGENT": [[1, 0, 0, 1]] * 3})
    writer.node(mesh=0)
    writer.node(mesh=1)
    scene = load(writer, tmp_path)
    first, second = (instance.mesh for instance in scene)
    assert first.normals is not None
    assert first.normals.tolist() == [[0, 0, 1]] * 3
    assert "zero length" in scene.warnings[0]
    assert second.normals is None
    assert second.tangents is None, "tangents without normals have no meaning"
