"""What OBJ, PLY and STL files say besides triangles: polygons, textures, colors, points, and their line ends."""

from __future__ import annotations

import struct
import sys

import numpy as np
import pytest
from support.files import image_file

import solari_vk as sv
from solari_vk.base.errors import SolariError

OUTLINES = {
    "notch": [(-1, -1), (1, -1), (1, 1), (0.8, 1), (0, -0.9), (-0.8, 1), (-1, 1)],
    "arrow": [(0, 1), (-1, -1), (0, 0), (1, -1)],
    "square": [(0, 0), (1, 0), (1, 1), (0, 1)],
}
TILT = np.array([[0.6, 0.0], [0.0, 1.0], [0.8, 0.0]])  # of a plane along no axis
HEAD = "ply\nformat {} 1.0\n{}element vertex {}\nproperty float x\nproperty float y\nproperty float z\n"
LISTS = "property list uchar int vertex_indices\n"


def area_and_normal(mesh):
    a, b, c = np.moveaxis(mesh.positions[mesh.triangles].astype(float), 1, 0)
    crossed = np.cross(b - a, c - a) / 2
    return np.linalg.norm(crossed, axis=1).sum(), crossed.sum(axis=0)


def polygons(kind, outlines):
    """A file with these polygons, one after the other."""
    points = np.concatenate(outlines)
    counts = [len(outline) for outline in outlines]
    faces = np.split(np.arange(len(points)), np.cumsum(counts)[:-1])
    if kind == "obj":
        parts = ["".join(f"v {x} {y} {z}\n" for x, y, z in outline) + "f" for outline in outlines]
        return "\n".join(
            part + "".join(f" {number - count}" for number in range(count))
            for part, count in zip(parts, counts, strict=True)
        ).encode()
    text = HEAD.format("ascii" if kind == "ply" else "binary_big_endian", "", len(points))
    text += f"element face {len(faces)}\n{LISTS}end_header\n"
    if kind == "ply":
        rows = [*points, *([len(face), *face] for face in faces)]
        return (text + "".join(" ".join(map(str, row)) + "\n" for row in rows)).encode()
    rows = (struct.pack(f">B{len(face)}i", len(face), *face) for face in faces)
    return text.encode() + points.astype(">f4").tobytes() + b"".join(rows)


@pytest.mark.parametrize("kind", ["obj", "ply", "binary.ply"])
def test_polygons_are_covered_and_no_more(tmp_path, kind):
    """From every first corner, by themselves and with others: areas are those of the shoelace formula."""
    path = tmp_path / f"a.{kind}"
    lone = [[np.roll(outline, first, axis=0)] for outline in OUTLINES.values() for first in range(len(outline))]
    for outlines in (*lone, [*OUTLINES.values()]):
        x, y = (np.concatenate([np.array(outline, float)[:, axis] for outline in outlines]) for axis in (0, 1))
        ends = np.concatenate([np.roll(np.array(outline, float), -1, axis=0) for outline in outlines])
        area = (x @ ends[:, 1] - y @ ends[:, 0]) / 2
        path.write_bytes(polygons(kind, [np.array(outline) @ TILT.T for outline in outlines]))
        (instance,) = sv.load(path)
        found, normal = area_and_normal(instance.mesh)
        assert found == pytest.approx(area, abs=1e-5)
        np.testing.assert_allclose(normal, area * np.array((-0.8, 0, 0.6)), atol=1e-5)


CORNERS = "-1 -1 0", "1 -1 0", "1 1 0", "-1 1 0"
SEAM = "3 0 1 2 6 0 0 1 0 1 1{}\n3 0 2 3 6 0.5 0 1 1 0 1{}\n"
RED, BLUE = (255, 0, 0), (0, 0, 255)


def ply(tmp_path, comments, properties, rows, face, faces):
    """The scene of a text file with four vertices."""
    head = HEAD.format("ascii", comments, 4) + properties + f"element face {faces.count(chr(10))}\n{LISTS}{face}"
    vertices = "".join(f"{corner}{row}\n" for corner, row in zip(CORNERS, rows, strict=True))
    (tmp_path / "a.ply").write_text(head + "end_header\n" + vertices + faces)
    return sv.load(tmp_path / "a.ply")


def test_textures_of_ply(tmp_path):
    for name, color in (("red.png", RED), ("b l.png", BLUE)):
        (tmp_path / name).write_bytes(image_file(np.full((2, 2, 3), color)))
    by_vertex = " 0 0", " 1 0", " 1 1", " 0 1"
    for u, v in (("s", "t"), ("u", "v"), ("texture_u", "texture_v")):
        names = f"property float {u}\nproperty float {v}\n"
        (one,) = ply(tmp_path, "comment TextureFile red.png\n", names, by_vertex, "", "4 0 1 2 3\n")
        assert one.material.base_color_texture.image.pixels[0, 0].tolist() == [*RED, 255]
        assert one.material.base_color.tolist() == [1, 1, 1]
        np.testing.assert_allclose(one.mesh.uvs, (one.mesh.positions[:, :2] * [1, -1] + 1) / 2)
    comments = "comment TextureFile red.png\ncomment TextureFile b l.png\n"
    given = "property list uchar float texcoord\nproperty int texnumber\n"
    scene = ply(tmp_path, comments, "", [""] * 4, given, SEAM.format(" 0", " 1"))
    assert [one.material.base_color_texture.image.pixels[0, 0, 0] for one in scene] == [255, 0]
    # The corner at the seam has other uvs on each side, and the surface bends nowhere.
    assert [one.mesh.uvs[one.mesh.triangles[0, 0]].tolist() for one in scene] == [[0, 1], [0.5, 1]]
    scene = ply(tmp_path, comments, "", [""] * 4, "property list uchar float texcoord\n", SEAM.format("", ""))
    (one,) = scene
    assert one.material.base_color_texture.image.pixels[0, 0, 0] == 255
    assert len(one.mesh.positions) == 6 - 1, "only one corner has the same uv twice"
    assert scene.warnings == ["textures are left out, since no 'texnumber' says which faces have them: b l.png"]
    scene = ply(tmp_path, comments, "", [""] * 4, given, SEAM.format(" -1", " 1"))
    assert [one.material.base_color_texture is None for one in scene] == [False, True]
    assert scene.warnings == ["faces whose 'texnumber' is that of no texture are gray: 1 triangles"]
    scene = ply(tmp_path, comments, "property float quality\n", [" 1"] * 4, "", "4 0 1 2 3\n")
    assert scene.warnings == [
        "properties that are ignored: quality of vertex",
        "textures are left out, since there are no uvs for them: red.png, b l.png",
    ]


def test_colors_of_ply_and_stl(tmp_path):
    properties = "".join(f"property uchar diffuse_{color}\n" for color in ("red", "green", "blue"))
    (one,) = ply(tmp_path, "", properties, [" 255 0 0"] * 4, "", "4 0 1 2 3\n")
    assert one.mesh.colors.tolist() == [[1, 0, 0]] * 4
    faces = "".join(f"property uchar {color}\n" for color in ("red", "green", "blue"))
    (one,) = ply(tmp_path, "", "", [""] * 4, faces, "3 0 1 2 255 0 0\n3 0 2 3 0 0 255\n")
    assert [one.mesh.colors[corners].tolist() for corners in one.mesh.triangles] == [[[1, 0, 0]] * 3, [[0, 0, 1]] * 3]
    triangle = struct.pack("<12f", 0, 0, 1, *map(float, " ".join(CORNERS[:3]).split()))
    # VisCAM: bit 15 says that there is a color, red above blue. Magics: that it is the header's; blue is above red.
    for head, words in ((b"", (0xFC00, 0x801F)), (b"COLOR=\x00\x00\xff\xff", (0x001F, 0x8000))):
        content = head.ljust(80) + struct.pack("<I", 2) + b"".join(triangle + struct.pack("<H", word) for word in words)
        (tmp_path / "a.stl").write_bytes(content)
        (one,) = sv.load(tmp_path / "a.stl", up="y")
        assert [one.mesh.colors[corners[0]].tolist() for corners in one.mesh.triangles] == [[1, 0, 0], [0, 0, 1]]


def test_points_without_faces_are_drawn(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0 1 0 0\nv 0 4 0 1 0 0\n")
    (tmp_path / "a.ply").write_text(HEAD.format("ascii", "", 2) + "end_header\n0 0 0\n0 4 0\n")
    for name in ("a.obj", "a.ply"):
        scene = sv.load(tmp_path / name)
        np.testing.assert_allclose(scene.bounds.size, [0.02, 4.02, 0.02], atol=5e-3)
        assert "points are drawn as spheres" in scene.warnings[0]
        assert (scene.instances[0].mesh.colors is not None) == (name == "a.obj")


TEXTS = {
    "a.obj": "# a comment\nmtllib a.mtl\nv -1 -1 0\nv 1 -1 0\nv 1 1 0\nusemtl red\nf 1 2 3\n",
    "a.stl": "solid\nfacet normal 0 0 1\nouter loop\nvertex -1 -1 0\nvertex 1 -1 0\nvertex 1 1 0\nendloop\nendfacet\n"
    "endsolid\n",
}


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
def test_line_ends_and_byte_order_marks(tmp_path, end, mark):
    (tmp_path / "a.mtl").write_bytes(mark + f"newmtl red{end}Kd 1 0 0{end}".encode())
    for name, text in TEXTS.items():
        (tmp_path / name).write_bytes(mark + text.replace("\n", end).encode())
        (one,) = sv.load(tmp_path / name)
        assert len(one.mesh.triangles) == 1
    # After a binary header that ends with CR, data may begin with LF.
    text = HEAD.format("binary_little_endian", "", 3) + f"element face 1\n{LISTS}end_header\n"
    number_with_a_line_end = struct.unpack("<f", b"\n\0\0\0")[0]
    data = struct.pack("<9fB3i", number_with_a_line_end, -1, 0, 1, -1, 0, 1, 1, 0, 3, 0, 1, 2)
    (tmp_path / "a.ply").write_bytes(mark + text.replace("\n", end).encode() + data + b"\r\n")
    assert len(sv.load(tmp_path / "a.ply").instances[0].mesh.triangles) == 1
    (tmp_path / "a.ply").write_bytes(text.replace("\n", end).encode() + data[:-1])
    with pytest.raises(SolariError, match=r"a\.ply: is cut off"):
        sv.load(tmp_path / "a.ply")


@pytest.mark.parametrize(
    "faces",
    [
        "f 1 2 \\\n3 4",
        "f 1 2 3 4 \\",
        "  f 1 2 3 4",
        "\tf 1 2 3 4 # red",
        "# C:\\parts\\\nf 1 2 3 4",
        "f 1/1 2/1 3/1 \\ \n 4/1#",
    ],
)
def test_lines_of_obj_may_be_continued_indented_and_commented(tmp_path, faces):
    corners = "".join(f"v {corner}\n" for corner in CORNERS)
    (tmp_path / "a.obj").write_text(f"{corners}vt 0 0\n{faces}\n")
    (one,) = sv.load(tmp_path / "a.obj")
    assert area_and_normal(one.mesh)[0] == 4


@pytest.mark.parametrize("corner", ["9" * 23, "-" + "9" * 23, "-" + "9" * 5000, "1.5", "/1", "x"])
def test_numbers_of_corners_that_are_none(tmp_path, corner):
    corners = "".join(f"v {corner}\n" for corner in CORNERS)
    for face in (f"f {corner} 1 2", f"f 1 2 3 {corner}"):
        (tmp_path / "a.obj").write_text(f"{corners}{face}\n")
        with pytest.raises(SolariError, match=r"a\.obj"):
            sv.load(tmp_path / "a.obj")


def test_lines_of_obj_are_warned_of_and_faces_without_area_refused(tmp_path):
    for face in ("f 1 2", "f 1", "f"):
        (tmp_path / "a.obj").write_text(f"v 0 0 0\nv 0 4 0\n{face}\n")
        with pytest.raises(SolariError, match="has faces that can't be read"):
            sv.load(tmp_path / "a.obj")
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 0 4 0\nl 1 2\n")
    assert sv.load(tmp_path / "a.obj").warnings[0] == "lines are left out, and only points are drawn"


def test_text_of_ply_has_the_types_of_its_header(tmp_path):
    colors = "".join(f"property uchar {color}\n" for color in ("red", "green", "blue"))
    (one,) = ply(tmp_path, "", colors, [" 1 0 1"] * 4, "", "4 0 1 2 3\n\x1a\0")
    assert one.mesh.colors.max() < 1e-3, "codes from 0 to 255, though none is above 1"
    for row, face, reason in (
        (" 1 0 0.5", "4 0 1 2 3\n", "0.5 where its header declares uint8"),
        (" 1 0 0", "4 0 1.5 2 3\n", "1.5 where its header declares int32"),
        (" 1 0 0", "4 0 1 2 3\n3.5 0 1 2\n", "3.5 values"),
        (" 1 0 300", "3 0 1 2\n", "300 where"),
    ):
        with pytest.raises(SolariError, match=reason):
            ply(tmp_path, "", colors, [row] * 4, "", face)
    with pytest.raises(SolariError, match="a name twice, 'property uchar red'"):
        ply(tmp_path, "", colors + colors, [" 1 0 1 1 0 1"] * 4, "", "4 0 1 2 3\n")
    with pytest.raises(SolariError, match="a name twice, 'element vertex 1'"):
        ply(tmp_path, "", "element vertex 1\n", [""] * 4, "", "4 0 1 2 3\n")


def test_faces_of_ply_are_read_or_refused(tmp_path, monkeypatch):
    monkeypatch.setitem(globals(), "LISTS", "property list uchar int vertex_list\n")
    (one,) = ply(tmp_path, "", "", [""] * 4, "", "4 0 1 2 3\n")
    assert area_and_normal(one.mesh)[0] == 4
    for face, rows in (("property list uchar int other\n", "3 0 1 2 1 0\n"), ("", "2 0 1\n")):
        with pytest.raises(SolariError, match="has faces that can't be read"):
            ply(tmp_path, "", "", [""] * 4, face, rows)
    text = HEAD.format("ascii", "", 3) + f"element tristrips 1\n{LISTS}end_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    (tmp_path / "a.ply").write_text(text)
    with pytest.raises(SolariError, match="has faces that can't be read"):
        sv.load(tmp_path / "a.ply")


def test_convex_polygons_need_no_library(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mapbox_earcut", None)
    angles = np.arange(9) * 2 * np.pi / 9
    outline = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    (tmp_path / "a.ply").write_bytes(polygons("ply", [outline @ TILT.T]))
    (one,) = sv.load(tmp_path / "a.ply")
    assert area_and_normal(one.mesh)[0] == pytest.approx(4.5 * np.sin(2 * np.pi / 9), abs=1e-5)
    (tmp_path / "a.ply").write_bytes(polygons("ply", [np.array(OUTLINES["notch"]) @ TILT.T]))
    with pytest.raises(SolariError, match="mapbox_earcut"):
        sv.load(tmp_path / "a.ply")
