"""The nodes that load_gltf reads: instances, hierarchies, scenes, cameras, lights, rest poses."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gltf_writer import TRIANGLE, GltfWriter

from solari_vk.errors import SolariError
from solari_vk.scene.gltf import load_gltf
from solari_vk.scene.model import Scene


def load(writer: GltfWriter, tmp_path: Path, **options: Any) -> Scene:
    return load_gltf(writer.save(tmp_path / "file.glb"), **options)


# ---- shared objects ---------------------------------------------------------------------------------


def test_nodes_share_meshes_and_materials(tmp_path: Path) -> None:
    writer = GltfWriter()
    material = writer.add("materials", name="paint")
    mesh = writer.mesh(material=material)
    copy = writer.add("meshes", primitives=[dict(writer.json["meshes"][mesh]["primitives"][0])])
    for number in (mesh, mesh, copy):
        writer.node(mesh=number)
    writer.json["meshes"].append({"primitives": [{**writer.json["meshes"][mesh]["primitives"][0]}] * 2, "name": "two"})
    writer.node(mesh=2)
    scene = load(writer, tmp_path)
    assert len(scene.instances) == 5
    assert len({instance.mesh for instance in scene}) == 1
    assert len({instance.material for instance in scene}) == 1
    assert [instance.name for instance in scene][3:] == ["two/0", "two/1"]


def test_two_primitives_of_a_shared_buffer_hold_only_what_they_use(tmp_path: Path) -> None:
    writer = GltfWriter()
    position = writer.accessor(np.random.default_rng(1).normal(size=(300, 3)))
    writer.mesh({"POSITION": position}, [0, 1, 2])
    writer.mesh({"POSITION": position}, [298, 299, 5])
    writer.node(mesh=0)
    writer.node(mesh=1)
    assert [len(instance.mesh.positions) for instance in load(writer, tmp_path)] == [3, 3]


# ---- nodes ------------------------------------------------------------------------------------------


def test_hierarchies_of_trs_and_matrices(tmp_path: Path) -> None:
    writer = GltfWriter()
    mesh = writer.mesh()
    half = math.sqrt(0.5)
    leaf = writer.node(mesh=mesh, scale=[2, 3, -4], name="leaf")
    # A quarter turn about z, by a quaternion without unit length.
    turned = writer.node(children=[leaf], rotation=[0, 0, 2 * half, 2 * half])
    matrix = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 10, 20, 30, 1]
    writer.node(children=[turned], matrix=matrix, name="root")
    (instance,) = load(writer, tmp_path)
    expected = [[0, -3, 0, 10], [2, 0, 0, 20], [0, 0, -4, 30], [0, 0, 0, 1]]
    np.testing.assert_allclose(instance.transform, expected, atol=1e-12)


def test_deep_hierarchies(tmp_path: Path) -> None:
    writer = GltfWriter()
    mesh = writer.mesh()
    depth = 20_000
    writer.json["nodes"] = [{"translation": [0, 0, 1], "children": [n + 1]} for n in range(depth)]
    writer.node(mesh=mesh)
    (instance,) = load(writer, tmp_path)
    assert instance.transform[2, 3] == depth


@pytest.mark.parametrize(
    "transform",
    [{"scale": [1, 0, 1]}, {"matrix": [0] * 16}, {"matrix": [1, 0, 0, 0.5, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]},
     {"scale": [1e300, 1e300, 1e300]}, {"rotation": [0, 0, 0, 0]}],
)  # fmt: skip
def test_singular_transforms_are_reported(tmp_path: Path, transform: dict[str, Any]) -> None:
    writer = GltfWriter()
    mesh = writer.mesh()
    inner = writer.node(mesh=mesh, name="flat", scale=[1e300, 1, 1])
    writer.node(children=[inner], **transform)
    scene = load(writer, tmp_path)
    assert not scene.instances
    assert scene.warnings == ["nodes whose transform is singular or not affine have no surface: node 0 'flat'"]


def test_hidden_nodes(tmp_path: Path) -> None:
    writer = GltfWriter()
    mesh = writer.mesh()
    child = writer.node(mesh=mesh)
    writer.node(children=[child], extensions={"KHR_node_visibility": {"visible": False}})
    scene = load(writer, tmp_path)
    assert [instance.visible for instance in scene] == [False]
    assert not scene.warnings


def test_gpu_instancing(tmp_path: Path) -> None:
    writer = GltfWriter()
    mesh = writer.mesh()
    attributes = {
        "TRANSLATION": writer.accessor([[1, 0, 0], [2, 0, 0]]),
        "SCALE": writer.accessor([[1, 1, 1], [2, 2, 2]]),
    }
    writer.node(mesh=mesh, translation=[0, 5, 0], extensions={"EXT_mesh_gpu_instancing": {"attributes": attributes}})
    scene = load(writer, tmp_path)
    assert [instance.transform[:2, 3].tolist() for instance in scene] == [[1, 5], [2, 5]]
    assert [instance.transform[0, 0] for instance in scene] == [1, 2]


# ---- scenes -----------------------------------------------------------------------------------------


def test_scenes_by_number_and_name(tmp_path: Path) -> None:
    writer = GltfWriter()
    mesh = writer.mesh()
    for name in ("a", "b"):
        node = writer.node(mesh=mesh, name=name)
        writer.add("scenes", nodes=[node], name=f"scene {name}")
    writer.json["scene"] = 1

    def shown(scene: int | str | None) -> list[str]:
        return [instance.name for instance in load(writer, tmp_path, scene=scene)]

    assert [shown(which) for which in (None, 0, 1, "scene a", "scene b")] == [["b"], ["a"], ["b"], ["a"], ["b"]]
    with pytest.raises(SolariError, match="no scene named 'c'; it has 2, named 'scene a', 'scene b'"):
        shown("c")
    with pytest.raises(SolariError, match="no scene 2; it has 2"):
        shown(2)


def test_files_without_scenes_show_all_roots(tmp_path: Path) -> None:
    writer = GltfWriter()
    mesh = writer.mesh()
    child = writer.node(mesh=mesh, name="child")
    writer.node(children=[child], mesh=mesh, name="root")
    writer.finish().pop("scenes")
    writer.json.pop("scene")
    path = tmp_path / "file.gltf"
    writer.json["buffers"][0]["uri"] = "file.bin"
    (tmp_path / "file.bin").write_bytes(writer.data)
    path.write_text(json.dumps(writer.json))
    assert [instance.name for instance in load_gltf(path)] == ["root", "child"]


# ---- cameras and lights -----------------------------------------------------------------------------


def test_cameras(tmp_path: Path) -> None:
    writer = GltfWriter()
    camera = writer.add("cameras", type="perspective", perspective={"yfov": 0.7, "znear": 0.1, "aspectRatio": 2.0})
    other = writer.add("cameras", type="orthographic", orthographic={}, name="flat")
    writer.node(camera=camera, name="eye", translation=[1, 2, 3], scale=[2, 2, 2])
    writer.node(camera=other)
    scene = load(writer, tmp_path)
    (found,) = scene.cameras
    assert (found.name, found.vertical_fov, found.near) == ("eye", 0.7, 0.1)
    np.testing.assert_allclose(found.transform, [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])
    assert scene.warnings == ["orthographic cameras are not supported and are left out: camera 1 'flat'"]


def test_directional_lights_and_reports_of_others(tmp_path: Path) -> None:
    writer = GltfWriter()
    kinds = [
        {"type": "directional", "intensity": 1000.0, "color": [1, 0.5, 0.25], "name": "sun"},
        {"type": "point", "name": "bulb"},
        {"type": "spot", "spot": {}},
        {"type": "point", "intensity": 0},
    ]
    writer.json["extensions"] = {"KHR_lights_punctual": {"lights": kinds}}
    half = math.sqrt(0.5)
    for number in range(4):
        writer.node(extensions={"KHR_lights_punctual": {"light": number}}, rotation=[-half, 0, 0, half])
    scene = load(writer, tmp_path)
    (light,) = scene.lights
    assert (light.name, light.illuminance) == ("sun", 1000)
    assert light.color.tolist() == [1, 0.5, 0.25]
    np.testing.assert_allclose(light.direction, [0, -1, 0], atol=1e-6)
    assert scene.warnings == [
        "point lights are not supported and are left out: node 1",
        "spot lights are not supported and are left out: node 2",
    ]


# ---- deformation ------------------------------------------------------------------------------------


def test_skins_and_morphs_are_shown_in_their_rest_pose(tmp_path: Path) -> None:
    writer = GltfWriter()
    target = writer.accessor([[0, 0, 1], [0, 0, 0], [0, 0, 0]])
    mesh = writer.mesh(
        {
            "NORMAL": [[0, 0, 1]] * 3,
            "JOINTS_0": writer.accessor([[0, 1, 0, 0]] * 3, "u1"),
            "WEIGHTS_0": [[0.5, 0.5, 0, 0]] * 3,
        },
        targets=[{"POSITION": target}],
    )
    writer.json["meshes"][mesh]["weights"] = [2.0]
    joints = [writer.node(translation=[4, 0, 0]), writer.node(translation=[0, 6, 0])]
    shift = np.tile(np.eye(4), (2, 1, 1))
    shift[:, 3, 2] = 1  # the format stores columns: one metre along z
    bind = writer.accessor(shift.reshape(2, 16))
    skin = writer.add("skins", joints=joints, inverseBindMatrices=bind)
    writer.node(mesh=mesh, skin=skin, translation=[100, 0, 0])
    writer.add("animations", name="walk", channels=[{"sampler": 0, "target": {"node": joints[0], "path": "scale"}}],
               samplers=[])  # fmt: skip
    scene = load(writer, tmp_path)
    (instance,) = scene
    expected = np.add(TRIANGLE, [2.0, 3.0, 1.0])
    expected[0, 2] += 2
    np.testing.assert_allclose(instance.mesh.positions, expected)
    assert instance.transform.tolist() == np.eye(4).tolist(), "the node's own transform has no say"
    assert scene.warnings == ["animations are not played: the rest pose is shown: animation 0 'walk'"]
