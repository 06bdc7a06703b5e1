"""Damaged and hostile files: one clear SolariError naming file, place and remedy; quickly, in bounded memory."""

from __future__ import annotations

import json
import os
import struct
import time
import tracemalloc
import zlib

import numpy as np
import pytest
from support.gltf_writer import TRIANGLE, encoded, glb

from solari_vk.errors import SolariError
from solari_vk.scene.gltf import load_gltf

GRAY = np.full((2, 2, 3), 128)


@pytest.fixture(autouse=True)
def quick_and_small():
    """Assert that each test takes less than 5 s and 300 MiB."""
    tracemalloc.start()
    started = time.perf_counter()
    yield
    seconds = time.perf_counter() - started
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert seconds < 5
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
    for length in range(0, len(whole), 7):
        assert refusal(basic.path, whole[:length])


@pytest.mark.parametrize(
    ("content", "message"),
    [(b"", "neither a .glb"), (b"hello", "neither a .glb"), (b"\xff\xfe{}", "neither a .glb"),
     (b"glTF" + b"\0" * 8, "ends inside its header"), (struct.pack("<4sIIII", b"glTF", 1, 20, 0, 0), "glTF 1 file"),
     (struct.pack("<4sIIII", b"glTF", 2, 20, 9, 0x4E4F534A), "says 9 bytes, but 0 are left"),
     (struct.pack("<4sIIII", b"glTF", 2, 20, 0, 0x004E4942), "first chunk of the .glb file is not JSON"),
     (b"[1]", "a JSON object"), (b"{}", "no 'asset'"), (b'{"asset": {"version": "1.0"}}', "needs glTF '1.0'"),
     (b'{"asset": {"version": "2.0", "minVersion": "2.1"}}', "needs glTF '2.1'"), (b'{"asset": []}', "JSON object"),
     (b'{"asset": {"version": 2.0}}', "'version' is 2.0, but must be a text"),
     (b'{"asset": {"version": "2.0"}, "nodes": {}, "scenes": [{"nodes": [0]}]}', "'nodes' is an object of 0"),
     (b'{"asset": {"version": "2.0"}, "x": ' + b"[" * 100_000, "nested too deeply"),
     (b'{"asset": {"version": "2.0"}, "x": ' + b"9" * 100_000 + b"}", "neither a .glb"),
     (b'{"asset": {"version": "2.0"}, "nodes": [{"translation": [NaN, 0, 0]}]}', "NaN is not a JSON number")],
)  # fmt: skip
def test_files_that_are_no_gltf(tmp_path, content, message):
    assert message in refusal(tmp_path / "file.glb", content)


def test_paths_that_are_no_files(tmp_path):
    os.mkfifo(tmp_path / "pipe.glb")
    for path, message in ((tmp_path / "none.glb", "no such file"), (tmp_path, "not a readable file|directory"),
                          (tmp_path / "pipe.glb", "not a readable file")):  # fmt: skip
        with pytest.raises(SolariError, match=message):
            load_gltf(path)


# ---- nothing outside the folder ---------------------------------------------------------------------


def show_image(basic, **image):
    """Give the triangle a material that shows an image."""
    texture = basic.add("textures", source=basic.add("images", **image))
    material = basic.add("materials", emissiveTexture={"index": texture})
    basic.json["meshes"][0]["primitives"][0]["material"] = material


@pytest.mark.parametrize("kind", ["buffers", "images"])
@pytest.mark.parametrize(
    "uri",
    ["../secret.bin", "..%2fsecret.bin", "%2e%2e/secret.bin", "sub/../../secret.bin", "/etc/passwd", "%2Fetc%2Fpasswd",
     "file:///etc/passwd", "http://127.0.0.1:9/x.bin", "C:\\secret.bin", "..\\secret.bin", "sub\\secret.bin",
     "link.bin", "linked/secret.bin", "\\\\host\\share", "~/x", ".", "", "a\0b", "file%00"],
)  # fmt: skip
def test_uris_outside_the_folder(tmp_path, basic, kind, uri):
    (tmp_path / "secret.bin").write_bytes(encoded(GRAY) * 10)
    folder = tmp_path / "folder"
    (folder / "sub").mkdir(parents=True)
    (folder / "link.bin").symlink_to(tmp_path / "secret.bin")
    (folder / "linked").symlink_to(tmp_path)
    if kind == "images":
        show_image(basic, uri=uri)
    content = basic.finish()
    content["buffers"][0]["uri"] = uri if kind == "buffers" else "file.bin"
    (folder / "file.bin").write_bytes(basic.data)
    message = refusal(folder / "file.gltf", content)
    assert message.startswith(f"{kind[:-1]} 0 has the 'uri'")
    assert "copy the file there" in message
    if kind == "images":
        scene = load_gltf(folder / "file.gltf")
        assert scene.instances[0].material.emissive_texture is None
        assert message in scene.warnings[0]


def test_uris_inside_the_folder_may_take_detours_and_links(tmp_path, basic):
    (tmp_path / "sub").mkdir()
    content = basic.finish()
    (tmp_path / "sub" / "real.bin").write_bytes(basic.data)
    (tmp_path / "link.bin").symlink_to("sub/real.bin")
    (tmp_path / "folder").symlink_to(tmp_path)
    for uri in ("./sub/../sub/real.bin", "link.bin"):
        content["buffers"][0]["uri"] = uri
        (tmp_path / "file.gltf").write_text(json.dumps(content))
        assert load_gltf(tmp_path / "file.gltf").instances
        assert load_gltf(tmp_path / "folder" / "file.gltf").instances


@pytest.mark.parametrize("endless", ["pipe", "device"])
def test_endless_buffers(tmp_path, basic, endless):
    content = basic.finish()
    content["buffers"][0]["uri"] = "endless.bin"
    if endless == "pipe":
        os.mkfifo(tmp_path / "endless.bin")
    else:
        (tmp_path / "endless.bin").symlink_to("/dev/zero")
    assert "endless.bin" in refusal(tmp_path / "file.gltf", content)


@pytest.mark.parametrize(
    ("uri", "message"),
    [("missing.bin", "buffer 0 needs the file 'missing.bin', which is not beside the glTF file"),
     ("data:;base64,####", "buffer 0 has a data URI that is not valid base64"), ("data:", "not valid base64"),
     ("data:;base64,AAAA", "buffer 0 says"), ("x" * 5000, "a 'uri' that no file can have"), (7, "must be a text")],
)  # fmt: skip
def test_buffers_without_their_data(tmp_path, basic, uri, message):
    content = basic.finish()
    content["buffers"][0]["uri"] = uri
    assert message in refusal(tmp_path / "file.gltf", content)


# ---- wrong numbers -------------------------------------------------------------------------------

HUGE = 10**15


@pytest.mark.parametrize(
    ("change", "message"),
    [(lambda j: j["accessors"][0].update(count=HUGE), "accessor 0 needs"),
     (lambda j: j["accessors"][0].update(count=4), "accessor 0 needs 48 bytes for its 4 elements"),
     (lambda j: j["accessors"][0].update(byteOffset=8), "accessor 0 needs"),
     (lambda j: j["accessors"][0].update(count=-1), "'count' is -1, but must be a whole number from 0"),
     (lambda j: j["accessors"][0].update(count=2.5), "'count' is 2.5"),
     (lambda j: j["accessors"][0].update(count=10**400), "'count' is 1000"),
     (lambda j: j["accessors"][0].update(count=True), "'count' is True"),
     (lambda j: j["accessors"][0].update(type="VEC2"), "has the type VEC2, but must be VEC3"),
     (lambda j: j["accessors"][0].update(type=[]), "'type' is a list of 0"),
     (lambda j: j["accessors"][0].update(componentType=5124), "'componentType' is 5124"),
     (lambda j: j["accessors"][2].update(componentType=5126), "must hold unsigned integers|needs"),
     (lambda j: j["accessors"][1].update(count=2), "has 2 of NORMAL for 3 positions"),
     (lambda j: j["accessors"][0].pop("count"), "'count' is missing"),
     (lambda j: (j["accessors"][0].pop("bufferView"), j["accessors"][0].update(count=HUGE),
                 j["accessors"][1].update(count=HUGE)), "has 1000000000000000 elements but no data"),
     (lambda j: j["bufferViews"][0].update(byteLength=HUGE), "bufferView 0 reaches from byte 0"),
     (lambda j: j["bufferViews"][0].update(byteOffset=HUGE), "bufferView 0 reaches"),
     (lambda j: j["bufferViews"][0].update(byteStride=4), "elements of 12 bytes in a view with a stride of 4"),
     (lambda j: j["bufferViews"][0].update(buffer=1), "refers to buffer 1, but the file has only 1"),
     (lambda j: j["buffers"][0].update(byteLength=HUGE), "buffer 0 says"),
     (lambda j: j["scenes"][0].update(nodes=[HUGE]), "scene 0 refers to node 1000000000000000"),
     (lambda j: j["scenes"][0].update(nodes=["0"]), "a list of whole numbers"),
     (lambda j: j.update(scene=3), "has no scene 3"),
     (lambda j: j["nodes"][0].update(mesh=5), "node 0 'arm' refers to mesh 5"),
     (lambda j: j["nodes"][0].update(children=[0]), "node 0 'arm' is reached twice"),
     (lambda j: j["nodes"][0].update(matrix=[1] * 15), "node 0 'arm' has a wrong field: 'matrix' is a list of 15"),
     (lambda j: j["nodes"][0].update(translation=[1e400, 0, 0]), "neither a .glb|3 finite numbers"),
     (lambda j: j["nodes"][0].update(rotation=["0", 0, 0, 1]), "4 finite numbers"),
     (lambda j: j["nodes"][0].update(name={}), "'name' is an object"),
     (lambda j: j["nodes"][0].update(extensions=3), "JSON object"),
     (lambda j: j["nodes"].__setitem__(0, None), "node 0 is None"),
     (lambda j: j["meshes"][0].update(primitives=[3]), "mesh 0, primitive 0 is 3"),
     (lambda j: j["meshes"][0]["primitives"][0].update(mode=7), "'mode' is 7"),
     (lambda j: j["meshes"][0]["primitives"][0].update(material=0), "refers to material 0, but the file has only 0"),
     (lambda j: j["meshes"][0]["primitives"][0]["attributes"].update(POSITION=1.5), "'POSITION' is 1.5"),
     (lambda j: j.update(extensionsRequired=["X" * 10_000]), "requires the extension XXXX"),
     (lambda j: j["nodes"][0].update(extensions={"KHR_lights_punctual": {"light": 0}}), "refers to light 0")],
)  # fmt: skip
def test_wrong_fields(basic, change, message):
    change(basic.finish())
    text = json.dumps(basic.json).replace("Infinity", "1e400").encode()
    found = refusal(basic.path, glb(text, bytes(basic.data)))
    assert any(part in found for part in message.split("|")), found


@pytest.mark.parametrize(
    ("mesh", "message"),
    [({"attributes": {"POSITION": [[0, 0, 0], [1, np.nan, 0], [0, 1, 0]]}}, "element 1"),
     ({"attributes": {"POSITION": [[0, 0, 0], [1, np.inf, 0], [0, 1, 0]]}}, "element 1"),
     ({"attributes": {"POSITION": [[0, 0, 0], [1, 1e30, 0], [0, 1, 0]]}}, "1e+18 meters"),
     ({"indices": [0, 1, 3]}, "mesh 0, primitive 0 refers to vertex 3 (accessor 1), but has only 3")],
)  # fmt: skip
def test_wrong_positions_and_indices(writer, mesh, message):
    writer.mesh(**mesh)
    assert message in refusal(writer.path, writer)


@pytest.mark.parametrize(
    ("count", "index", "message"),
    [(4, 0, "accessor 0, sparse has a wrong field: 'count' is 4"), (HUGE, 0, "accessor 0, sparse"),
     (1, 3, "sparse, indices refers to element 3, but there are 3"), (1, 255, "element 255, but there are 3")],
)  # fmt: skip
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


def test_accessors_without_data(writer):
    for _ in range(200):
        writer.mesh({"POSITION": writer.add("accessors", componentType=5126, count=2**24, type="VEC3")})
    assert "MiB large although the file's buffers have only 0 MiB" in refusal(writer.path, writer)


@pytest.mark.parametrize("size", [(16385, 1), (1, 20000), (2**31 - 1, 2**31 - 1), (12000, 12000), (0, 5)])
def test_giant_images(basic, size):
    file = bytearray(encoded(GRAY))
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
    monkeypatch.setattr("solari_vk.scene.gltf.loader.Instance", refuse)
    assert refusal(writer.path, writer) == "Instance: too heavy"


def test_names_that_can_not_be_printed(basic):
    basic.json["nodes"][0].update(name="\ud800" + "x" * 10_000, mesh=7)
    refusal(basic.path, basic).encode()


def test_the_scene_may_be_empty(writer):
    scene = writer.load()
    assert not scene.instances
    assert not scene.warnings
