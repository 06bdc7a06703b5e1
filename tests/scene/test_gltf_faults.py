"""Files with a fault that costs one part of them, which is reported, or nothing at all."""

from __future__ import annotations

import json
import re

import DracoPy
import numpy as np
import pytest
from support.files import DRACO, TRIANGLE

from solari_vk.base.errors import SolariError

NAN = [[0, 0, 0], [1, np.nan, 0], [0, 1, 0]]
ATTRIBUTES = {
    "NORMAL": [[0, 0, 1]] * 3,
    "TANGENT": [[1, 0, 0, 1]] * 3,
    "TEXCOORD_0": [[0, 0], [1, 0], [0, 1]],
    "COLOR_0": [[0.5, 0.5, 0.5]] * 3,
}
FIELDS = {"NORMAL": "normals", "TANGENT": "tangents", "TEXCOORD_0": "uvs", "COLOR_0": "colors"}


# ---- what costs one part ----------------------------------------------------------------------------


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ATTRIBUTES)
def test_an_attribute_that_is_not_finite_costs_itself(writer, name, value):
    wrong = np.array(ATTRIBUTES[name], float)
    wrong[1, 1] = value
    writer.mesh({**ATTRIBUTES, name: wrong}, [0, 1, 2])
    scene = writer.load_with_loss("all values must be finite; export the file again")
    assert scene.warnings[0].startswith("wrong attributes are left out: accessor")
    (instance,) = scene
    lost = {name, "TANGENT"} if name == "NORMAL" else {name}
    assert {key for key, field in FIELDS.items() if getattr(instance.mesh, field) is None} == lost
    assert instance.mesh.positions.tolist() == TRIANGLE


def test_an_attribute_of_another_count_or_type_costs_itself(writer):
    writer.mesh({"NORMAL": [[0, 0, 1]] * 2})
    writer.mesh({"NORMAL": [[0, 1]] * 3})
    scene = writer.load_with_loss("has 2 of NORMAL for 3 positions")
    assert [instance.mesh.normals for instance in scene] == [None, None]
    assert "has the type VEC2, but must be VEC3" in scene.warnings[0]


@pytest.mark.parametrize(
    ("mesh", "message"),
    [
        ({"attributes": {"POSITION": NAN}}, "element 1"),
        ({"attributes": {"POSITION": [[0, 0, 0], [1, 1e30, 0], [0, 1, 0]]}}, r"1e\+18 meters"),
        ({"indices": [0, 1, 3]}, r"mesh 0, primitive 0 refers to vertex 3 \(accessor 1\), but has only 3"),
        ({"mode": 9}, "'mode' is 9"),
    ],
)
def test_wrong_data_cost_the_primitive_and_a_file_without_any_other_is_refused(writer, mesh, message):
    writer.mesh(**mesh)
    with pytest.raises(SolariError, match=message):
        writer.load()
    writer.mesh({"POSITION": [[5, 0, 0], [6, 0, 0], [5, 1, 0]]})
    del writer.json["nodes"], writer.json["scenes"], writer.json["buffers"]
    (instance,) = writer.load_with_loss(message)
    assert instance.mesh.positions[0, 0] == 5


def test_wrong_materials_are_the_default_one(writer):
    writer.mesh(material=7)
    writer.mesh(material=writer.add("materials", alphaMode="blend"))
    scene = writer.load_with_loss("refers to material 7|'alphaMode' is 'blend'")
    assert [instance.material.name for instance in scene] == ["default", "default"]
    [warning] = scene.warnings
    assert "refers to material 7" in warning
    assert "'alphaMode' is 'blend', but must be one of OPAQUE, MASK, BLEND" in warning


def test_morph_targets_that_are_not_finite_change_nothing(writer):
    targets = [{"POSITION": writer.accessor(NAN)}, {"POSITION": writer.accessor([[0, 0, 1]] * 3)}]
    writer.node(mesh=writer.mesh(targets=targets), weights=[1, 1])
    (instance,) = writer.load_with_loss("must be finite")
    np.testing.assert_allclose(instance.posed_mesh().positions, np.add(TRIANGLE, [0, 0, 1]))


def test_instances_that_are_not_finite_cost_their_node(writer):
    instancing = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": writer.accessor(NAN)}}}
    writer.node(mesh=writer.mesh(), extensions=instancing)
    writer.node(mesh=0, name="other")
    assert writer.load_with_loss("must be finite").instances.names == ["other"]


def test_wrong_cameras_cost_themselves(writer):
    writer.node(mesh=writer.mesh())
    for yfov in (-1, 0.7):
        writer.node(camera=writer.add("cameras", type="perspective", perspective={"yfov": yfov, "znear": 0.1}))
    assert len(writer.load_with_loss("camera 0, perspective has a wrong field: 'yfov'").cameras) == 1


def test_faults_of_buffers_cost_the_file(writer):
    """A buffer that is cut off has more wrong than the part that first meets it."""
    writer.mesh()
    writer.mesh({"NORMAL": [[0, 0, 1]] * 3})
    writer.json["bufferViews"][-1]["byteLength"] = 2**20
    with pytest.raises(SolariError, match="the file is truncated or damaged"):
        writer.load()


# ---- what costs nothing -----------------------------------------------------------------------------


def test_whole_numbers_may_be_written_as_floats(writer):
    image = writer.image(np.full((2, 2, 3), 128))
    pbr = {"baseColorTexture": {"index": image, "texCoord": 0}}
    sampler = writer.add("samplers", wrapS=33071, minFilter=9729)
    writer.json["textures"][image]["sampler"] = sampler
    writer.mesh(ATTRIBUTES, [0, 1, 2], mode=4, material=writer.add("materials", pbrMetallicRoughness=pbr))
    writer.animate(writer.node(mesh=0, children=[1]), "translation", [0, 1], [[0, 0, 0], [1, 0, 0]])
    writer.node()
    text = json.dumps(writer.finish())
    floats = json.loads(re.sub(r"(?<=[ \[])(\d+)(?=[,}\]])", r"\1.0", text))
    assert floats["accessors"][0]["count"] == 3
    assert isinstance(floats["nodes"][0]["children"][0], float)
    writer.json.clear()
    writer.json.update(floats)
    scene = writer.load(strict=True)
    assert (len(scene.instances), len(scene.animations), scene.warnings) == (1, 1, [])
    assert scene.instances[0].material.base_color_texture.wrap_u == "clamp_to_edge"
    writer.json["nodes"][0]["children"] = [1.5]
    with pytest.raises(SolariError, match="a list of whole numbers"):
        writer.load()


@pytest.mark.parametrize(("version", "least"), [("2.1", "2.0"), ("2.1", None), ("2.7", "2"), ("2.0", "1.0")])
def test_later_versions_that_can_be_read_as_2_0(writer, version, least):
    writer.mesh()
    writer.json["asset"] = {"version": version} | ({} if least is None else {"minVersion": least})
    scene = writer.load(strict=True)
    assert len(scene.instances) == 1
    remark = [f"versions of glTF after 2.0 are read as 2.0: {version}"]
    assert scene.warnings == (remark if version != "2.0" else [])
    writer.json["asset"]["minVersion"] = "2.1"
    with pytest.raises(SolariError, match=r"needs glTF '2\.1'; only 2\.0 can be read"):
        writer.load()


def test_buffers_without_data_that_nothing_uses(writer):
    """Neither their absence nor that of a file matters, as long as no shown part refers to them."""
    writer.mesh()
    buffers = writer.finish()["buffers"]
    buffers += [{"byteLength": 24}, {"byteLength": 0}, {"byteLength": 9, "uri": "missing.bin"}]
    for number in (1, 2, 3):
        view = writer.add("bufferViews", buffer=number, byteLength=4)
        writer.add("accessors", bufferView=view, componentType=5126, type="SCALAR", count=1)
        writer.add("images", bufferView=view)
    assert len(writer.load(strict=True).instances) == 1
    writer.json["bufferViews"][0]["buffer"] = 1
    with pytest.raises(SolariError, match="buffer 1 has no data: neither a 'uri' nor"):
        writer.load()


@pytest.mark.parametrize(("dtype", "fits"), [("f4", True), ("i1", True), ("i2", True), ("f4", False), ("i1", False)])
def test_joints_and_indices_in_types_that_are_not_for_them(writer, dtype, fits):
    joints = writer.accessor([[0, 1 if fits else (0.5 if dtype == "f4" else -1), 0, 0]] * 3, dtype, stride=16)
    weights = writer.accessor([[0.5, 0.5, 0, 0]] * 3)
    mesh = writer.mesh({"JOINTS_0": joints, "WEIGHTS_0": weights}, writer.accessor([2, 0, 1], dtype))
    first, second = writer.node(), writer.node()
    writer.node(mesh=mesh, skin=writer.add("skins", joints=[first, second]))
    (instance,) = writer.load() if fits else writer.load_with_loss("must hold unsigned integers, not")
    assert instance.mesh.positions[instance.mesh.triangles[0, 0]].tolist() == [0, 1, 0]
    deformation = instance.mesh.deformation
    assert (deformation.joints.tolist() == [[0, 1]] * 3) if fits else deformation is None


@pytest.mark.parametrize("bits", [0, 8])
def test_joints_that_draco_has_as_floats(writer, bits):
    """They get the accessor's type, also when Draco has quantized them."""
    joints = np.array([[0, 1, 0, 0], [1, 18, 0, 0], [7, 0, 0, 0]], np.float32)
    if bits:
        steps = (2**bits - 1) / joints.max()
        joints = (np.rint(joints * steps) / steps).astype(np.float32)
        assert (joints % 1).any()
    weights = np.array([[0.5, 0.5, 0, 0]] * 3, np.float32)
    packed = DracoPy.encode(
        np.array(TRIANGLE, float),
        np.array([[0, 1, 2]], np.uint32),
        preserve_order=True,
        generic_attributes={3: joints, 4: weights},
        quantization_bits=14,
    )
    given = {item["unique_id"]: item["data"] for item in DracoPy.decode(packed).attributes}
    assert given[3].dtype.kind == "f"
    attributes = {}
    for name, kind, component in (("POSITION", "VEC3", 5126), ("JOINTS_0", "VEC4", 5121), ("WEIGHTS_0", "VEC4", 5126)):
        attributes[name] = writer.add("accessors", count=3, type=kind, componentType=component)
    indices = writer.add("accessors", count=3, type="SCALAR", componentType=5123)
    (position,) = given.keys() - {3, 4}
    ids = {"POSITION": position, "JOINTS_0": 3, "WEIGHTS_0": 4}
    extension = {"bufferView": writer.view(packed), "attributes": ids}
    mesh = writer.mesh(attributes, indices, extensions={DRACO: extension})
    nodes = [writer.node() for _ in range(19)]
    writer.node(mesh=mesh, skin=writer.add("skins", joints=nodes))
    (instance,) = writer.load(strict=True)
    assert sorted(instance.mesh.deformation.joints.max(axis=1).tolist()) == [1, 7, 18]
