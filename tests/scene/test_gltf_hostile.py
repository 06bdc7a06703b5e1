"""Damaged and hostile files: one clear SolariError naming file, place and remedy, in bounded memory."""

from __future__ import annotations

import functools
import json
import operator
import os
import struct
import tracemalloc
import zlib

import numpy as np
import pytest
from support.files import TRIANGLE, image_file

from solari_vk.base.errors import SolariError
from solari_vk.scene.files.gltf import load_gltf

GRAY = np.full((2, 2, 3), 128)


@pytest.fixture(autouse=True)
def little_memory():
    """Assert that each test takes less than 300 MiB."""
    tracemalloc.start()
    yield
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 300 * 2**20


@pytest.fixture
def basic(writer):
    """A file with a triangle on a node."""
    writer.mesh({"NORMAL": [[0, 0, 1]] * 3}, [0, 1, 2])
    writer.node(mesh=0, name="arm")
    return writer


def refusal(path, content):
    """The message of the error for a file, which must name the file. content: bytes, JSON, or a writer of a .glb."""
    if isinstance(content, dict):
        content = json.dumps(content).encode()
    path.write_bytes(content if isinstance(content, bytes) else content.glb())
    with pytest.raises(SolariError) as caught:
        load_gltf(path, strict=True)
    assert str(caught.value).startswith(f"{path}: ")
    assert len(str(caught.value)) < 700
    return str(caught.value).removeprefix(f"{path}: ")


# ---- the container ----------------------------------------------------------------------------------


def test_a_truncated_glb_is_refused_at_every_length(basic):
    whole = basic.glb()
    for length in range(0, len(whole), 11):
        assert refusal(basic.path, whole[:length])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "neither a .glb"),
        (b"hello", "neither a .glb"),
        (b"\xff\xfe{}", "neither a .glb"),
        (b"glTF" + b"\0" * 8, "ends inside its header"),
        (struct.pack("<4sIIII", b"glTF", 1, 20, 0, 0), "gltf-pipeline"),
        (struct.pack("<4sIIII", b"glTF", 2, 20, 9, 0x4E4F534A), "says 9 bytes, but 0 are left"),
        (struct.pack("<4sIIII", b"glTF", 2, 20, 0, 0x004E4942), "first chunk of the .glb file is not JSON"),
        (b"[1]", "a JSON object"),
        (b"{}", "no 'asset'"),
        (b'{"asset": {"version": "1.0"}}', "npx gltf-pipeline -i"),
        (b'{"asset": {"version": "2.0", "minVersion": "2.1"}}', "needs glTF '2.1'"),
        (b'{"asset": []}', "JSON object"),
        (b'{"asset": {"version": 2.0}}', "'version' is 2.0, but must be a text"),
        (b'{"asset": {"version": "2.0"}, "nodes": {}, "scenes": [{"nodes": [0]}]}', "'nodes' is an object of 0"),
        (b'{"asset": {"version": "2.0"}, "x": ' + b"[" * 100_000, "nested too deeply"),
        (b'{"asset": {"version": "2.0"}, "x": ' + b"9" * 100_000 + b"}", "neither a .glb"),
        (b'{"asset": {"version": "2.0"}, "nodes": [{"translation": [NaN, 0, 0]}]}', "NaN is not a JSON number"),
    ],
)
def test_files_that_are_no_gltf(tmp_path, content, message):
    assert message in refusal(tmp_path / "file.glb", content)


@pytest.mark.posix
def test_paths_that_are_no_files(tmp_path):
    os.mkfifo(tmp_path / "pipe.glb")
    for path, message in (
        (tmp_path / "none.glb", "no such file"),
        (tmp_path, "not a readable file|directory"),
        (tmp_path / "pipe.glb", "not a readable file"),
    ):
        with pytest.raises(SolariError, match=message):
            load_gltf(path)


# ---- nothing outside the folder ---------------------------------------------------------------------


def show_image(basic, **image):
    """Give the triangle a material that shows an image."""
    texture = basic.add("textures", source=basic.add("images", **image))
    material = basic.add("materials", emissiveTexture={"index": texture})
    basic.json["meshes"][0]["primitives"][0]["material"] = material


URIS = [
    "../secret.bin",
    "..%2fsecret.bin",
    "%2e%2e/secret.bin",
    "sub/../../secret.bin",
    "/etc/passwd",
    "file:///etc/passwd",
    "%2Fetc%2Fpasswd",
    "http://127.0.0.1:9/x.bin",
    "C:\\secret.bin",
    "..\\secret.bin",
    "sub\\secret.bin",
    "link.bin",
    "linked/secret.bin",
    "\\\\host\\share",
    "~/x",
    ".",
    "",
    "a\0b",
    "file%00",
]


@pytest.mark.posix
@pytest.mark.parametrize("kind", ["buffers", "images"])
def test_uris_outside_the_folder(tmp_path, basic, kind):
    (tmp_path / "secret.bin").write_bytes(image_file(GRAY) * 10)
    folder = tmp_path / "folder"
    (folder / "sub").mkdir(parents=True)
    (folder / "link.bin").symlink_to(tmp_path / "secret.bin")
    (folder / "linked").symlink_to(tmp_path)
    if kind == "images":
        show_image(basic)
    content = basic.finish()
    content["buffers"][0]["uri"] = "file.bin"
    (folder / "file.bin").write_bytes(basic.data)
    for uri in URIS:
        content[kind][0]["uri"] = uri
        message = refusal(folder / "file.gltf", content)
        assert message.startswith(f"{kind[:-1]} 0 has the 'uri'"), uri
        assert "copy the file there" in message
        if kind == "images":
            scene = load_gltf(folder / "file.gltf")
            assert scene.instances[0].material.emissive_texture is None
            assert message in scene.warnings[0]


@pytest.mark.posix
def test_uris_inside_the_folder_may_take_detours_and_links(tmp_path, basic):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "real.bin").write_bytes(basic.data)
    (tmp_path / "link.bin").symlink_to("sub/real.bin")
    (tmp_path / "folder").symlink_to(tmp_path)
    content = basic.finish()
    for uri in ("./sub/../sub/real.bin", "link.bin"):
        content["buffers"][0]["uri"] = uri
        (tmp_path / "file.gltf").write_text(json.dumps(content))
        assert load_gltf(tmp_path / "file.gltf").instances
        assert load_gltf(tmp_path / "folder" / "file.gltf").instances


@pytest.mark.posix
def test_endless_buffers(tmp_path, basic):
    content = basic.finish()
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "device").symlink_to("/dev/zero")
    for uri in ("pipe", "device"):
        content["buffers"][0]["uri"] = uri
        assert uri in refusal(tmp_path / "file.gltf", content)


@pytest.mark.parametrize(
    ("uri", "message"),
    [
        ("missing.bin", "buffer 0 needs the file 'missing.bin', which is not beside the glTF file"),
        ("data:;base64,####", "buffer 0 has a data URI that is not valid base64"),
        ("data:", "not valid base64"),
        ("data:;base64,AAAA", "buffer 0 says"),
        ("x" * 5000, "a 'uri' that no file can have"),
        (7, "must be a text"),
    ],
)
def test_buffers_without_their_data(tmp_path, basic, uri, message):
    content = basic.finish()
    content["buffers"][0]["uri"] = uri
    assert message in refusal(tmp_path / "file.gltf", content)


# ---- wrong numbers -------------------------------------------------------------------------------

HUGE = 10**15


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        ("accessors 0 count", HUGE, "accessor 0 needs"),
        ("accessors 0 count", 4, "accessor 0 needs 48 bytes for its 4 elements"),
        ("accessors 0 count", -1, "'count' is -1, but must be a whole number from 0"),
        ("accessors 0 count", 10**400, "'count' is 1000"),
        ("accessors 0 count", True, "'count' is True"),
        ("accessors 0 type", "VEC2", "has the type VEC2, but must be VEC3"),
        ("accessors 0 type", [], "'type' is a list of 0"),
        ("accessors 0 componentType", 5124, "'componentType' is 5124"),
        ("accessors 1 count", 2, "has 2 of NORMAL for 3 positions"),
        ("bufferViews 0 byteLength", HUGE, "bufferView 0 reaches from byte 0"),
        ("bufferViews 0 byteStride", 4, "elements of 12 bytes in a view with a stride of 4"),
        ("bufferViews 0 buffer", 1, "refers to buffer 1, but the file has only 1"),
        ("buffers 0 byteLength", HUGE, "buffer 0 says"),
        ("scenes 0 nodes", [HUGE], "scene 0 refers to node 1000000000000000"),
        ("scenes 0 nodes", ["0"], "a list of whole numbers"),
        ("scene", 3, "has no scene 3"),
        ("nodes 0 mesh", 5, "node 0 'arm' refers to mesh 5"),
        ("nodes 0 matrix", [1] * 15, "node 0 'arm' has a wrong field: 'matrix' is a list of 15"),
        ("nodes 0 rotation", ["0", 0, 0, 1], "4 finite numbers"),
        ("nodes 0 extensions", 3, "JSON object"),
        ("nodes 0 extensions", {"KHR_lights_punctual": {"light": 0}}, "refers to light 0"),
        ("nodes 0", None, "node 0 is None"),
        ("meshes 0 primitives", [3], "mesh 0, primitive 0 is 3"),
        ("meshes 0 primitives 0 mode", 7, "'mode' is 7"),
        ("meshes 0 primitives 0 material", 0, "refers to material 0, but the file has only 0"),
        ("extensionsRequired", ["X" * 10_000], "requires the extension XXXX"),
    ],
)
def test_wrong_fields(basic, place, value, message):
    *path, last = (int(part) if part.isdigit() else part for part in place.split())
    holder = functools.reduce(operator.getitem, path, basic.finish())
    holder[last] = value
    assert message in refusal(basic.path, basic)


@pytest.mark.parametrize(
    ("count", "index", "message"),
    [
        (4, 0, "accessor 0, sparse has a wrong field: 'count' is 4"),
        (HUGE, 0, "accessor 0, sparse"),
        (1, 3, "sparse, indices refers to element 3, but there are 3"),
    ],
)
def test_sparse_accessors_beyond_their_base(basic, count, index, message):
    basic.json["accessors"][0]["sparse"] = {
        "count": count,
        "indices": {"bufferView": basic.view(bytes([index])), "componentType": 5121},
        "values": {"bufferView": basic.view(bytes(12))},
    }
    assert message in refusal(basic.path, basic)


def test_nodes_with_two_parents_and_cycles(basic):
    basic.node(children=[0, 2])
    basic.node(children=[0], name="second")
    assert "node 0 'arm' is reached twice, the second time from node 2 'second'" in refusal(basic.path, basic)
    content = {"asset": {"version": "2.0"}, "nodes": [{"children": [1]}, {"children": [0]}]}
    assert "form a cycle" in refusal(basic.path, content)
    content["scenes"] = [{"nodes": [0]}]
    assert "is reached twice" in refusal(basic.path, content)


# ---- small files that expand ------------------------------------------------------------------------


def test_a_mesh_of_many_primitives_on_many_nodes(writer):
    writer.mesh()
    writer.json["meshes"][0]["primitives"] *= 3000
    writer.json["nodes"] = [{"mesh": 0}] * 3000
    assert "instances of primitives; split the file" in refusal(writer.path, writer)


@pytest.mark.parametrize(("use", "message"), [("mesh", "overlap"), ("instancing", "above")])
def test_accessors_over_the_same_bytes(writer, use, message):
    mesh = writer.mesh({"POSITION": np.tile(TRIANGLE, (20_000, 1))})
    first = writer.json["accessors"][0]
    for number in range(1, 500):
        again = writer.add("accessors", **{**first, "count": 3 * (20_000 - number)})
        if use == "mesh":
            writer.node(mesh=writer.mesh({"POSITION": again}))
        else:
            writer.node(mesh=mesh, extensions={"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": again}}})
    assert message in refusal(writer.path, writer)


def test_accessors_without_data(basic):
    empty = {"componentType": 5126, "count": HUGE, "type": "VEC3"}
    basic.json["accessors"] = [empty, empty, basic.json["accessors"][2]]
    assert "has 1000000000000000 elements but no data" in refusal(basic.path, basic)
    basic.json["accessors"] = [empty | {"count": 2**24}] * 200
    basic.json["meshes"] = [{"primitives": [{"attributes": {"POSITION": number}}]} for number in range(200)]
    assert "MiB large although the file's buffers have only 0 MiB" in refusal(basic.path, basic)
    del basic.json["accessors"][0]["count"]
    assert "'count' is missing" in refusal(basic.path, basic)


@pytest.mark.parametrize("size", [(16385, 1), (1, 20000), (2**31 - 1, 2**31 - 1), (12000, 12000), (0, 5)])
def test_giant_images(basic, size):
    file = bytearray(image_file(GRAY))
    file[16:24] = struct.pack(">II", *size)
    file[29:33] = struct.pack(">I", zlib.crc32(file[12:29]))
    show_image(basic, bufferView=basic.view(bytes(file)), name="sky")
    message = refusal(basic.path, basic)
    assert message.startswith("image 0 'sky' ")
    assert "scale it down" in message or "damaged" in message


def test_errors_of_the_scenes_classes_name_the_file(writer, monkeypatch):
    def refuse(*_, **__):
        raise SolariError("Instance: too heavy")

    writer.mesh()
    monkeypatch.setattr("solari_vk.scene.files.gltf.loader.Instance", refuse)
    assert refusal(writer.path, writer) == "Instance: too heavy"


def test_names_that_can_not_be_printed(basic):
    basic.json["nodes"][0].update(name="\ud800" + "x" * 10_000, mesh=7)
    refusal(basic.path, basic).encode()


def test_the_scene_may_be_empty(writer):
    scene = writer.load()
    assert (list(scene), scene.warnings) == ([], [])
