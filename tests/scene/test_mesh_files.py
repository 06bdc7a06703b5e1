"""Meshes from OBJ, PLY and STL files: geometry, materials, normals, axes, and what is damaged or outside the folder."""

from __future__ import annotations

import os
import re
import struct
import sys

import numpy as np
import pytest
import trimesh
from support.files import KTX2_ETC1S, image_file

import solari_vk as sv
from solari_vk.base.errors import SolariError

PLANE = """mtllib plane.mtl
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 3 3 3
vt 0 0
vt 1 0
vt 1 1
vt 0 1
usemtl red
f 1/1 2/2 3/3 4/4
usemtl lamp
f 1/1 3/3 5/2
"""
MTL = """# a comment
newmtl red
Kd 0.8 0.1 0.1
Ns 98
map_Kd -blendu on wood.png
newmtl lamp
Kd 0 0 0
Ke 5 4 3
Pr 0.25
Pm 1
Ni 1.33
d 0.5
"""


@pytest.fixture
def plane(tmp_path):
    (tmp_path / "plane.obj").write_text(PLANE)
    (tmp_path / "plane.mtl").write_text(MTL)
    (tmp_path / "wood.png").write_bytes(image_file(np.full((2, 2, 3), [90, 60, 30])))
    return tmp_path / "plane.obj"


def test_obj_with_materials(plane):
    scene = sv.load(plane)
    assert (scene.name, scene.warnings) == ("plane", [])
    by_material = {instance.material.name: instance for instance in scene}
    red, lamp = by_material["red"].material, by_material["lamp"].material
    np.testing.assert_allclose(red.base_color, [0.8, 0.1, 0.1], rtol=1e-6)
    assert red.perceptual_roughness == pytest.approx((2 / 100) ** 0.25)
    assert red.base_color_texture.image.pixels[0, 0].tolist() == [90, 60, 30, 255]
    assert (lamp.metallic, lamp.perceptual_roughness) == (1, 0.25)
    assert (lamp.alpha, lamp.alpha_mode, red.alpha, red.alpha_mode) == (0.5, "blend", 1, "opaque")
    assert lamp.emissive.tolist() == [5, 4, 3]
    np.testing.assert_allclose(lamp.reflectance, 0.33 / 2.33 / 0.4, rtol=1e-6)
    mesh = by_material["red"].mesh
    assert len(mesh.triangles) == 2
    order = np.lexsort(mesh.positions.T)
    np.testing.assert_allclose(mesh.uvs[order], [[0, 1], [1, 1], [0, 0], [1, 0]], err_msg="v points down, as in glTF")
    np.testing.assert_allclose(mesh.normals, [[0, 0, 1]] * 4, atol=1e-6)


@pytest.mark.posix
def test_names_of_files_may_differ_in_case_alone(plane):
    for name, other in (("wood.png", "Wood.PNG"), ("plane.mtl", "PLANE.mtl")):
        (plane.parent / name).rename(plane.parent / other)
    assert sv.load(plane).warnings == []
    (plane.parent / "WOOD.png").touch()
    assert "no such file" in sv.load(plane).warnings[0], "either could be meant"


def test_what_mtl_files_say_without_effect_is_reported(plane, monkeypatch):
    plane.with_name("old wood.png").write_bytes(plane.with_name("wood.png").read_bytes())
    plane.with_name("plane.mtl").write_text(
        "newmtl red\nKs 1 1 1\nmap_Ns d.png\nillum 2\nmap_Kd -s 2 2 -bm 0.5 old wood.png\nnewmtl other\nTf 1 1 1\n"
        "map_Kd gone.png\n"
    )
    scene = sv.load(plane)
    (red,) = (m for m in scene.materials if m.name == "red")
    assert red.base_color_texture.image.name == "old wood.png"
    assert scene.warnings == [
        "materials that no .mtl file has are replaced by a gray one: lamp",
        "fields and options of the .mtl file that are ignored: Ks, map_Ns, -s, -bm",
    ]
    monkeypatch.setattr("solari_vk.scene.files.mtl.LARGEST_FILE", 3)
    with pytest.raises(SolariError, match="more than"):
        sv.load(plane, strict=True)


def exported(mesh, kind):
    """The bytes of a file."""
    data = mesh.export(file_type=kind, **({"vertex_normal": True} if kind == "ply" else {}))
    return data.encode() if isinstance(data, str) else data


@pytest.mark.parametrize("kind", ["ply", "stl", "obj", "stl_ascii"])
def test_formats_give_the_same_ball(tmp_path, kind):
    ball = trimesh.creation.icosphere(subdivisions=3)
    path = tmp_path / f"ball.{kind.split('_')[0].upper()}"
    path.write_bytes(exported(ball, kind))
    (instance,) = sv.load(path, up="y")
    mesh = instance.mesh
    assert len(mesh.triangles) == len(ball.faces)
    assert len(mesh.positions) == len(ball.vertices), "a smooth surface needs no vertex twice"
    np.testing.assert_allclose(mesh.normals, mesh.positions, atol=0.01)


def test_edges_stay_sharp(tmp_path):
    trimesh.creation.box().export(tmp_path / "box.stl")
    mesh = sv.load(tmp_path / "box.stl").instances[0].mesh
    assert len(mesh.positions) == 24
    np.testing.assert_allclose(np.abs(mesh.normals).max(axis=1), 1, atol=1e-6)
    trimesh.creation.cylinder(1, 2, sections=32).export(tmp_path / "can.ply")
    mesh = sv.load(tmp_path / "can.ply").instances[0].mesh
    wall = np.abs(mesh.normals[:, 2]) < 0.5
    np.testing.assert_allclose(mesh.normals[wall, :2], mesh.positions[wall, :2], atol=0.02)
    np.testing.assert_allclose(np.abs(mesh.normals[~wall, 2]), 1, atol=1e-6)


@pytest.mark.parametrize(
    ("suffix", "up", "top"), [("stl", None, 2), ("stl", "y", 1), ("ply", None, 1), ("ply", "x", 0)]
)
def test_axes_and_units(tmp_path, suffix, up, top):
    box = trimesh.creation.box((1, 2, 3))
    box.apply_translation(np.eye(3)[top] * 1000)
    box.export(tmp_path / f"box.{suffix}")
    bounds = sv.load(tmp_path / f"box.{suffix}", up=up, unit=0.001).bounds
    np.testing.assert_allclose(bounds.center, [0, 1, 0], atol=1e-6)
    assert bounds.size[1] == pytest.approx((1, 2, 3)[top] / 1000, abs=1e-6)
    mesh = sv.load(tmp_path / f"box.{suffix}", up=up).instances[0].mesh
    a, b, c = (mesh.positions[mesh.triangles[:, i]] for i in range(3))
    outside = ((a + b + c) / 3 - [0, 1000, 0]) * np.cross(b - a, c - a)
    assert (outside.sum(axis=1) > 0).all(), "turning must not mirror"


@pytest.mark.parametrize("format", ["ply", "obj"])
def test_given_normals_and_colors_of_vertices_are_kept(tmp_path, format):
    ball = trimesh.creation.icosphere(subdivisions=1)
    ball.vertex_normals = -ball.vertices
    ball.visual.vertex_colors = np.where(ball.vertices[:, :1] > 0, [[188, 0, 255, 255]], [[255, 255, 255, 255]])
    (tmp_path / f"ball.{format}").write_bytes(exported(ball, format))
    scene = sv.load(tmp_path / f"ball.{format}")
    (instance,) = scene
    assert scene.warnings == []
    assert instance.material.base_color.tolist() == [1, 1, 1]
    mesh = instance.mesh
    if format == "ply":
        np.testing.assert_allclose(mesh.normals, -mesh.positions, atol=1e-6)
    right = mesh.positions[:, 0] > 0
    np.testing.assert_allclose(mesh.colors[right], np.tile([0.503, 0, 1], (right.sum(), 1)), atol=2e-3)
    np.testing.assert_allclose(mesh.colors[~right], 1)


def test_textures_that_need_a_missing_library_are_warned_of(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "opengl_basisu", None)
    (tmp_path / "plane.obj").write_text(PLANE)
    (tmp_path / "plane.mtl").write_text("newmtl red\nmap_Kd wood.ktx2\nnewmtl lamp\n")
    (tmp_path / "wood.ktx2").write_bytes(KTX2_ETC1S)
    with pytest.warns(UserWarning, match="textures are left out: .*wood.ktx2.*pip install 'solari-vk") as warned:
        scene = sv.load(tmp_path / "plane.obj")
    assert [str(one.message) for one in warned] == scene.warnings


@pytest.mark.posix
@pytest.mark.parametrize(
    ("mtl", "reason"),
    [
        (None, "'plane.mtl'.*no such file"),
        ("newmtl red\nmap_Kd gone.png\n", "'gone.png'.*no such file"),
        (
            "newmtl red\nmap_Kd plane.obj\n",
            "'plane.obj' is not a PNG, JPEG, WebP, KTX2, DDS, EXR, BMP, GIF, TIFF or TGA image",
        ),
        ("newmtl red\nmap_Kd ../secret.png\n", "outside the model's folder"),
        ("newmtl red\nmap_Kd /etc/passwd\n", "outside the model's folder"),
        ("newmtl red\nmap_Kd link.png\n", "outside the model's folder"),
        ("newmtl red\nmap_Kd a\0b\n", "no file can have"),
    ],
)
def test_materials_that_can_not_be_read(tmp_path, mtl, reason):
    (tmp_path / "secret.png").write_bytes(image_file(np.zeros((1, 1, 3))))
    folder = tmp_path / "model"
    folder.mkdir()
    (folder / "link.png").symlink_to(tmp_path / "secret.png")
    (folder / "plane.obj").write_text(PLANE)
    if mtl is not None:
        (folder / "plane.mtl").write_text(mtl)
    scene = sv.load(folder / "plane.obj")
    assert all(instance.material.base_color_texture is None for instance in scene)
    assert re.search(reason, scene.warnings[0])
    with pytest.raises(SolariError, match=reason):
        sv.load(folder / "plane.obj", strict=True)


BIG = "ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\nproperty float y\n"


VERTICES = b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.obj", b""),
        ("a.obj", b"vn 0 0 1\n"),
        ("a.obj", VERTICES + b"f 1 2 9\n"),
        ("a.obj", VERTICES.replace(b"v 1", b"v nan") + b"f 1 2 3\n"),
        ("a.obj", VERTICES.replace(b"v 1", b"v 0") + b"f 1 2 3\n"),
        ("a.stl", b"solid"),
        ("a.stl", bytes(84)),
        ("a.stl", bytes(80) + struct.pack("<I", 2**31)),
        ("a.ply", b"ply\nend_header\n"),
        ("a.ply", BIG.encode() + b"property float z\nend_header\n" + bytes(100)),
    ],
)
def test_files_without_a_surface(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(SolariError, match="^" + re.escape(str(tmp_path / name))):
        sv.load(tmp_path / name)


@pytest.mark.parametrize("face", ["1 2 0", "1/1 2/0 3/1", "1//0 2//0 3//0"])
def test_indices_of_obj_begin_at_1(tmp_path, face):
    (tmp_path / "a.obj").write_bytes(VERTICES + b"vt 0 0\nvn 0 0 1\nf " + face.encode() + b"\n")
    with pytest.raises(SolariError, match=r"a\.obj: has a face with an index of 0.*begin at 1"):
        sv.load(tmp_path / "a.obj")


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_damage_is_not_logged(tmp_path, capfd, caplog):
    """The library logs a traceback for a damaged normal, which isn't used, and numpy warns of NaN that signal."""
    ball = trimesh.creation.icosphere(subdivisions=1)
    text = ball.export(file_type="stl_ascii").replace("facet normal", "facet normal x", 1)
    (tmp_path / "text.stl").write_text(text)
    assert np.isfinite(sv.load(tmp_path / "text.stl").instances[0].mesh.normals).all()
    data = bytearray(ball.export(file_type="stl"))
    data[96:100] = struct.pack("<I", 0x7FA00000)
    (tmp_path / "bytes.stl").write_bytes(data)
    with pytest.raises(SolariError, match=r"bytes\.stl: .*aren't finite"):
        sv.load(tmp_path / "bytes.stl")
    assert not caplog.records
    assert capfd.readouterr() == ("", "")


@pytest.mark.posix
@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("none.ply", {}, "no such file"),
        ("pipe.stl", {}, "not a readable file"),
        ("plane.obj", {"up": "w"}, r"plane\.obj: up: .*'x', 'y' or 'z'"),
        ("plane.obj", {"unit": 0}, "the unit must be"),
        ("plane.obj", {"variant": "red"}, "only glTF files have"),
        ("x.fbx", {}, r"x\.fbx: .*give a file of \.gltf, .*\.stl"),
        ("x.glb", {"up": "z"}, "only .obj, .ply, .stl files need"),
    ],
)
def test_wrong_use(plane, name, options, message):
    os.mkfifo(plane.with_name("pipe.stl"))
    with pytest.raises(SolariError, match=message):
        sv.load(plane.with_name(name), **options)


def test_a_missing_library_is_named_with_what_installs_it(plane, monkeypatch):
    monkeypatch.setitem(sys.modules, "trimesh.exchange.load", None)
    with pytest.raises(SolariError, match=r"pip install 'solari-vk\[formats\]'"):
        sv.load(plane)
