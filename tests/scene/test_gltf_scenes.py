"""The nodes that load_gltf reads: instances, hierarchies, scenes, cameras, lights, rest poses."""

from __future__ import annotations

import cProfile
import math
from pathlib import Path

import numpy as np
import pytest
from support.files import GltfWriter

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.scene.files.gltf import EXTENSIONS, load_gltf
from solari_vk.scene.matrices import transform_points

HALF = math.sqrt(0.5)

# ---- shared objects ---------------------------------------------------------------------------------


def test_nodes_share_meshes_and_materials(writer):
    mesh = writer.mesh(material=writer.add("materials", name="paint"))
    [primitive] = writer.json["meshes"][mesh]["primitives"]
    copy = writer.add("meshes", primitives=[dict(primitive)])
    two = writer.add("meshes", primitives=[dict(primitive)] * 2, name="two")
    for number in (mesh, mesh, copy, two):
        writer.node(mesh=number)
    scene = writer.load()
    assert len(scene.instances) == 5
    assert len({instance.mesh for instance in scene}) == 1
    assert len({instance.material for instance in scene}) == 1
    assert [instance.name for instance in scene][3:] == ["two/0", "two/1"]


def test_two_primitives_of_a_shared_buffer_hold_only_what_they_use(writer):
    position = writer.accessor(np.random.default_rng(1).normal(size=(300, 3)))
    writer.mesh({"POSITION": position}, [0, 1, 2])
    writer.mesh({"POSITION": position}, [298, 299, 5])
    assert [len(instance.mesh.positions) for instance in writer.load()] == [3, 3]


# ---- nodes ------------------------------------------------------------------------------------------


def test_hierarchies_of_trs_and_matrices(writer):
    leaf = writer.node(mesh=writer.mesh(), scale=[2, 3, -4], name="leaf")
    # A quarter turn about z, by a quaternion without unit length.
    turned = writer.node(children=[leaf], rotation=[0, 0, 2 * HALF, 2 * HALF])
    writer.node(children=[turned], matrix=[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 10, 20, 30, 1], name="root")
    (instance,) = writer.load()
    expected = [[0, -3, 0, 10], [2, 0, 0, 20], [0, 0, -4, 30], [0, 0, 0, 1]]
    np.testing.assert_allclose(instance.transform, expected, atol=1e-12)


def test_nodes_that_hold_several_objects_are_groups(writer):
    mesh = writer.mesh()
    wheels = [writer.node(mesh=mesh, name=f"wheel {number}", translation=[number, 0, 0]) for number in range(2)]
    axle = writer.node(children=wheels, name="axle", translation=[0, 0, 5])
    chain = writer.node(children=[axle], name="exported")
    body = writer.node(mesh=mesh, name="body")
    writer.node(children=[body, chain], mesh=mesh, name="car", scale=[2, 2, 2])
    writer.node(children=[writer.node(mesh=mesh, name="alone")])
    scene = writer.load()
    assert scene.groups.names == ["car", "axle"]
    car, axle = scene.groups
    assert [item.name for item in car] == ["car", "body", "axle"], "nodes with one child are left out"
    assert [item.name for item in axle] == ["wheel 0", "wheel 1"]
    assert axle.position == pytest.approx((0, 0, 10))
    scene["axle"].position = 0, 3, 0
    assert scene["wheel 1"].position == pytest.approx((2, 3, 0))
    assert scene["alone"].position == pytest.approx((0, 0, 0))


def test_chains_of_groups_end(writer):
    depth = 3000
    mesh = writer.mesh()
    writer.json["nodes"] = [{"children": [n + 1], "mesh": mesh} for n in range(depth)]
    writer.node(mesh=mesh)
    scene = writer.load()
    assert len(scene.instances) == depth + 1
    assert 60 < len(scene.groups) < 70
    assert len(scene.groups[0].items) == len(scene.groups) + 1


def test_deep_hierarchies(writer):
    depth = 3000  # beyond Python's limit of recursion
    writer.json["nodes"] = [{"translation": [0, 0, 1], "children": [n + 1]} for n in range(depth)]
    writer.node(mesh=writer.mesh())
    (instance,) = writer.load()
    assert instance.transform[2, 3] == depth


def test_work_grows_with_the_file(writer):
    """Four times as many objects of all kinds take four times as many calls of functions, not their square."""

    def calls(count):
        one = GltfWriter(writer.path)
        for number in range(count):
            mesh = one.mesh(material=one.add("materials", name=f"paint {number}"))
            node = one.node(mesh=mesh)
            one.clip(f"clip {number}")
            one.animate(node, "translation", [0, 1], [[0, 0, 0], [1, 0, 0]])
        one.save(one.path)
        with cProfile.Profile() as profile:
            load_gltf(one.path)
        return sum(entry.callcount for entry in profile.getstats())

    assert calls(80) < 4.5 * calls(20)


@pytest.mark.parametrize(
    "transform",
    [
        {"scale": [1, 0, 0]},
        {"matrix": [0] * 16},
        {"matrix": [1, 0, 0, 0.5, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]},
        {"scale": [1e300, 1e300, 1e300]},
    ],
)
def test_singular_transforms_are_reported(writer, transform):
    inner = writer.node(mesh=writer.mesh(), name="flat", scale=[1e300, 1, 1])
    writer.node(children=[inner], **transform)
    scene = writer.load()
    assert not scene.instances
    remark = "nodes whose transform isn't affine, or has a scale of 0 along more than one axis, have no surface"
    assert scene.warnings == [f"{remark}: node 0 'flat'"]


def flat_nodes(writer):
    shape = writer.mesh({"POSITION": [[0, 0, 1], [4, 0, 2], [0, 4, 3]]})
    writer.node(mesh=shape, scale=[1, 1, 0])
    writer.node(children=[writer.node(mesh=shape)], scale=[1, 1, 0])
    writer.node(mesh=shape, matrix=[1, 0, 0, 0, 0, 1, 0, 0, 0.5, 0.25, 0, 0, 0, 0, 0, 1])  # a shadow below a sun
    animated = writer.node(mesh=shape)
    writer.animate(animated, "scale", [0, 1], [[1, 1, 1], [1, 1, 0]])
    scene = writer.load()
    scene.animate(1, loop=False)
    return list(scene.instances)


def test_what_is_scaled_to_nothing_along_an_axis_is_flat(writer):
    """By a node, a parent, a matrix, a clip, `scale`, `transform` and a group: glTF 2.0, 3.5.3 hides only what all
    three axes are 0 of."""
    shown = flat_nodes(writer)
    scene = sv.Scene(*(sv.Instance(shown[0].mesh) for _ in range(3)))
    scene.instances[0].scale = (1, 1, 0)
    scene.instances[1].transform = np.diag([1, 1, 0, 1])
    scene.group(scene.instances[2]).scale = (1, 1, 0)
    for one in (*shown, *scene):
        assert one.visible
        points = transform_points(one.transform, one.mesh.positions)
        skew = np.outer(one.mesh.positions[:, 2], (0.5, 0.25)) if one is shown[2] else 0
        np.testing.assert_allclose(points[:, :2], one.mesh.positions[:, :2] + skew, atol=1e-3)
        np.testing.assert_allclose(points[:, 2], 0, atol=1e-3)
        assert np.linalg.det(one.transform) > 0, "rays and normals need an inverse"
    one.scale = 1
    np.testing.assert_allclose(one.transform, np.eye(4), atol=1e-9)


def test_quaternions_of_length_0_are_named(writer):
    node = writer.node(mesh=writer.mesh(), rotation=[0, 0, 0, 0])
    writer.animate(node, "rotation", [0, 1], [[0, 0, 0, 0], [0, 0, 0, 1]])
    scene = writer.load()
    np.testing.assert_allclose(scene.instances[0].transform, np.eye(4))
    (warning,) = scene.warnings
    assert warning.startswith("rotations of length 0, which are no unit quaternions, turn nothing: ")
    assert "node 0" in warning
    assert "animation 0" in warning


def test_hidden_nodes(writer):
    child = writer.node(mesh=writer.mesh())
    writer.node(children=[child], extensions={"KHR_node_visibility": {"visible": False}})
    scene = writer.load()
    assert ([instance.visible for instance in scene], scene.warnings) == ([False], [])


def test_gpu_instancing(writer):
    translation, scale = writer.accessor([[1, 0, 0], [2, 0, 0]]), writer.accessor([[1, 1, 1], [2, 2, 2]])
    instancing = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": translation, "SCALE": scale}}}
    writer.node(mesh=writer.mesh(), translation=[0, 5, 0], extensions=instancing)
    places = [instance.transform[:2, [0, 3]].tolist() for instance in writer.load()]
    assert places == [[[1, 1], [0, 5]], [[2, 2], [0, 5]]]


# ---- scenes -----------------------------------------------------------------------------------------


def test_scenes_by_number_and_name(writer):
    mesh = writer.mesh()
    for name in ("a", "b"):
        writer.add("scenes", nodes=[writer.node(mesh=mesh, name=name)], name=f"scene {name}")
    writer.json["scene"] = 1
    for which, name in ((None, "b"), (0, "a"), (1, "b"), ("scene a", "a"), ("scene b", "b")):
        assert writer.load(scene=which).instances.names == [name]
    with pytest.raises(SolariError, match="no scene named 'c'; it has 2, named 'scene a', 'scene b'"):
        writer.load(scene="c")
    with pytest.raises(SolariError, match="no scene 2; it has 2"):
        writer.load(scene=2)


def test_files_without_scenes_show_all_roots(writer, monkeypatch):
    mesh = writer.mesh()
    writer.node(children=[writer.node(mesh=mesh, name="child")], mesh=mesh, name="root")
    monkeypatch.setattr(writer, "scene", lambda *_: None)
    assert writer.load().instances.names == ["root", "child"]
    assert "scenes" not in writer.json


def test_the_most_detailed_level_is_shown(writer):
    """Coarser levels are nodes or materials that MSFT_lod names, also where they are in the scene."""
    materials = [writer.add("materials", name=name) for name in ("fine", "coarse")]
    writer.json["materials"][0]["extensions"] = {"MSFT_lod": {"ids": [materials[1]]}}
    mesh = writer.mesh(material=materials[0])
    leaf = writer.node(mesh=mesh, name="coarse leaf")
    coarse = writer.node(mesh=mesh, name="coarse", children=[leaf])
    fine = writer.node(mesh=mesh, name="fine", extensions={"MSFT_lod": {"ids": [coarse]}})
    writer.scene(coarse, fine)
    writer.json["extensionsUsed"] = writer.json["extensionsRequired"] = ["MSFT_lod"]
    scene = writer.load(strict=True)
    assert (scene.instances.names, scene.instances[0].material.name, scene.warnings) == (["fine"], "fine", [])


def test_positions_stay_relative_to_their_center(writer):
    writer.mesh()
    writer.json["extensions"] = {"CESIUM_RTC": {"center": [4123456.5, -5e6, 1.5]}}
    writer.json["extensionsRequired"] = ["CESIUM_RTC"]
    scene = writer.load(strict=True)
    assert scene.bounds[1].tolist() == [1, 1, 0]
    assert scene.warnings == ["positions are left relative to the center of CESIUM_RTC: 4123456.5, -5000000, 1.5"]
    writer.json["extensions"]["CESIUM_RTC"]["center"] = [1]
    writer.load_with_loss("'center' is a list of 1")


# ---- lights -----------------------------------------------------------------------------------------


def test_lights(writer):
    """Lights take the place and turn of their node, never its scale."""
    kinds = [
        {"type": "directional", "intensity": 1000.0, "color": [1, 0.5, 0.25], "name": "sun"},
        {"type": "point", "name": "bulb", "intensity": 40, "range": 12.5},
        {"type": "spot", "spot": {}, "range": 0, "intensity": 1e20},
        {"type": "spot", "name": "stage", "spot": {"innerConeAngle": 0.25, "outerConeAngle": math.pi / 2}},
        {"type": "spot", "name": "hard", "spot": {"innerConeAngle": 0.5, "outerConeAngle": 0.5}},
    ]
    writer.json["extensions"] = {"KHR_lights_punctual": {"lights": kinds}}
    children = [
        writer.node(
            extensions={"KHR_lights_punctual": {"light": number}},
            rotation=[-HALF, 0, 0, HALF],
            translation=[number, 0, 0],
        )
        for number in range(len(kinds))
    ]
    writer.node(children=children, scale=[2, 2, 5], translation=[0, 3, 0])
    scene = writer.load()
    sun, bulb, plain, stage, hard = scene.lights
    assert (sun.name, sun.illuminance) == ("sun", 1000)
    assert sun.color.tolist() == [1, 0.5, 0.25]
    assert [light.position.tolist() for light in (bulb, plain, stage)] == [[2, 3, 0], [4, 3, 0], [6, 3, 0]]
    assert (bulb.name, bulb.intensity, bulb.range, bulb.radius) == ("bulb", 40, 12.5, 0)
    assert (plain.intensity, plain.range, plain.inner_cone_angle, plain.outer_cone_angle) == (
        1e15,
        None,
        0,
        math.pi / 4,
    )
    assert (stage.inner_cone_angle, stage.outer_cone_angle) == (0.25, math.pi / 2)
    assert 0.499 < hard.inner_cone_angle < hard.outer_cone_angle == 0.5
    for light in (sun, plain, stage):
        np.testing.assert_allclose(light.direction, [0, -1, 0], atol=1e-6)
    place = "the file, extensions, KHR_lights_punctual, light"
    assert scene.warnings == [
        f"lights brighter than 1e+15 are dimmed to that: {place} 2",
        f"lights with a range of 0, which glTF forbids, reach without end: {place} 2",
        f"spotlights with cones of the same angle get a hard edge: {place} 4",
    ]


def test_lights_of_singular_nodes(writer):
    """A point light needs a place only."""
    writer.json["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": kind} for kind in ("point", "spot")]}}
    for number in range(2):
        writer.node(extensions={"KHR_lights_punctual": {"light": number}}, scale=[0, 0, 0], translation=[1, 2, 3])
    scene = writer.load()
    assert [light.position.tolist() for light in scene.lights] == [[1, 2, 3]]
    assert scene.warnings == ["lights whose node's transform is singular are left out: node 1"]


@pytest.mark.parametrize(
    "light",
    [
        {"type": "point", "intensity": -1},
        {"type": "point", "range": -1},
        {"type": "area"},
        {"type": "spot", "spot": {"outerConeAngle": 2}},
        {"type": "spot", "spot": {"innerConeAngle": -0.1}},
        {"type": "point", "color": [1, 1]},
    ],
)
def test_wrong_lights(writer, light):
    writer.json["extensions"] = {"KHR_lights_punctual": {"lights": [light]}}
    writer.node(extensions={"KHR_lights_punctual": {"light": 0}})
    assert not writer.load_with_loss("light 0").lights


LARGEST = float(np.finfo(np.float32).max)


def test_numbers_without_a_maximum_may_be_the_largest_float(writer):
    """glTF sets no upper limit to these, and exporters write the largest float for "no limit"."""
    kinds = [{"type": kind, "intensity": 7.0, "range": LARGEST} for kind in ("point", "spot")]
    kinds += [{"type": kind, "intensity": LARGEST} for kind in ("point", "directional")]
    writer.json["extensions"] = {"KHR_lights_punctual": {"lights": kinds}}
    for number in range(len(kinds)):
        writer.node(extensions={"KHR_lights_punctual": {"light": number}})
    lens = {"xmag": LARGEST, "ymag": LARGEST, "znear": 0.1, "zfar": LARGEST}
    writer.json["cameras"] = [{"type": "orthographic", "orthographic": lens}]
    writer.node(camera=0)
    strength = {"KHR_materials_emissive_strength": {"emissiveStrength": LARGEST}}
    turn = {"KHR_materials_anisotropy": {"anisotropyStrength": 0.5, "anisotropyRotation": -LARGEST}}
    writer.json["materials"] = [{"emissiveFactor": [1, 0.5, 0], "extensions": strength | turn}]
    writer.node(mesh=writer.mesh(material=0))
    scene = writer.load()
    *lamps, sun = scene.lights
    assert [(lamp.range, lamp.intensity) for lamp in lamps] == [(None, 7), (None, 7), (None, 1e15)]
    assert sun.illuminance == 1e15
    assert len(scene.cameras) == 1
    material = next(iter(scene.instances)).material
    np.testing.assert_allclose(material.emissive, [1e18, 5e17, 0])
    assert material.anisotropy == 0.5
    assert [line.split(":")[0] for line in scene.warnings] == [
        "materials brighter than 1e+18 cd/m^2 are dimmed to that",
        "lights brighter than 1e+15 are dimmed to that",
    ]
    assert sv.PointLight((0, 0, 0), range=LARGEST).range == LARGEST
    assert sv.PointLight((0, 0, 0), range=math.inf).range is None


# ---- extensions -------------------------------------------------------------------------------------


def test_the_page_of_extensions_shows_the_table():
    rows = "".join(f"| {name} | {status} | {remark} |\n" for name, status, remark, *_ in EXTENSIONS)
    page = Path(__file__).parents[2] / "docs" / "gltf.md"
    assert f"| --- | --- | --- |\n{rows}\n" in f"{page.read_text()}\n", f"the rows of docs/gltf.md must be\n{rows}"
    assert len({extension.name for extension in EXTENSIONS}) == len(EXTENSIONS)
    assert all(extension.remark for extension in EXTENSIONS if extension.status != "works")


def test_a_file_may_require_what_the_table_shows(writer):
    writer.mesh()
    for name, status, *_ in EXTENSIONS:
        writer.json["extensionsRequired"] = [name]
        if status == "no":
            with pytest.raises(SolariError, match=f"{name}, which is not supported"):
                writer.load()
        else:
            assert len(writer.load().instances) == 1
