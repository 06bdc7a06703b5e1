"""Small files that want much memory are refused before they get it, and what is charged is what loading takes."""

from __future__ import annotations

import json
import os
import re
import struct
import subprocess
import sys
import zlib

import numpy as np
import pytest
from support.files import TRIANGLE, GltfWriter

import solari_vk as sv
from solari_vk.base.budget import parse_size

MIB = 2**20
SPARE = 48 * MIB  # libraries that are imported, and what the allocator keeps
LOADER = """
import json, os, sys, warnings
import numpy, PIL.Image, OpenEXR, trimesh.exchange.load
import solari_vk as sv
from solari_vk.base.budget import load_budget
status = lambda: open("/proc/self/status").read()  # the maximum of getrusage may be that of the parent
peak = lambda: int(status().partition("VmHWM:")[2].split()[0]) << 10
warnings.simplefilter("ignore")
for line in sys.stdin:
    path, limit = json.loads(line)
    if os.fork():
        os.wait()
        continue
    before, said = peak(), ""
    with load_budget(limit) as budget:
        try:
            sv.Environment(path) if path.endswith((".hdr", ".exr")) else sv.load(path)
        except sv.SolariError as error:
            said = str(error)
    print(json.dumps((budget.peak, peak() - before, said)), flush=True)
    os._exit(0)
"""


@pytest.fixture(scope="module")
def load():
    """load(path, limit): what loading a file in a process of its own charges, the memory that it takes, its error."""
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", LOADER], stdin=pipe, stdout=pipe, text=True) as loader:

        def ask(path, limit):
            loader.stdin.write(json.dumps((str(path), limit)) + "\n")
            loader.stdin.flush()
            return json.loads(loader.stdout.readline())

        yield ask


def png(width, height):
    """A black picture, as small as it gets."""
    rows, packer = bytes(width + 1), zlib.compressobj(9)
    data = b"".join(packer.compress(rows) for _ in range(height)) + packer.flush()
    chunks = [(b"IHDR", struct.pack(">2I5B", width, height, 8, 0, 0, 0, 0)), (b"IDAT", data), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body)) for name, body in chunks
    )


def gltf(folder):
    return GltfWriter(folder / "bomb.glb")


def morphs(folder, n):
    """Targets that all are one accessor without data."""
    made = gltf(folder)
    empty = made.add("accessors", componentType=5126, count=1024 * n, type="VEC3")
    positions = made.accessor(np.random.default_rng(0).normal(size=(1024 * n, 3)))
    made.mesh({"POSITION": positions}, targets=[{"POSITION": empty}] * 16)
    return made


def images(folder, n):
    made = gltf(folder)
    for number in range(8):
        view = made.view(png(256 * n, 64 + number))
        texture = made.add("textures", source=made.add("images", bufferView=view, mimeType="image/png"))
        material = made.add("materials", pbrMetallicRoughness={"baseColorTexture": {"index": texture}})
        made.mesh({"TEXCOORD_0": [[0, 0]] * 3}, material=material)
    return made


def decoded(folder, n, *format, **options):
    """Pictures that take more memory while they are decoded than after it."""
    made = gltf(folder)
    texture = {"index": made.image(np.zeros((256 * n, 256 * n, 3)), *format, **options)}
    made.mesh({"TEXCOORD_0": [[0, 0]] * 3}, material=made.add("materials", normalTexture=texture))
    return made


def webp(folder, n):
    return decoded(folder, n, "WEBP", lossless=True, method=0)


def progressive(folder, n):
    return decoded(folder, n, "JPEG", progressive=True)


def animations(folder, n):
    """Channels that all have the same keys."""
    made = gltf(folder)
    made.mesh()
    times, values = made.accessor(np.arange(1024.0)), made.accessor(np.zeros((1024, 3)))
    channel = {"sampler": 0, "target": {"node": 0, "path": "translation"}}
    sampler = {"input": times, "output": values}
    made.add("animations", samplers=[sampler], channels=[channel] * (16 * n))
    return made


def primitives(folder, n):
    """Primitives of the same vertices and different indices."""
    made = gltf(folder)
    positions = made.accessor(np.random.default_rng(0).normal(size=(3 * 4096, 3)))
    indices = [made.accessor(np.roll(np.arange(3 * 4096), turn), "u4") for turn in range(4)]
    shared = {"POSITION": positions}
    parts = [{"attributes": shared, "indices": index, "mode": mode} for index in indices for mode in (4, 5, 6)]
    made.json["meshes"] = [{"primitives": parts}] * n
    return made


def skins(folder, n):
    """Many nodes with one skin of many joints."""
    made = gltf(folder)
    mesh = made.mesh({"JOINTS_0": made.accessor([[0, 0, 0, 0]] * 3, "u2"), "WEIGHTS_0": [[1, 0, 0, 0]] * 3})
    joints = [made.node() for _ in range(1024)]
    made.add("skins", joints=joints)
    made.scene(*joints, *(made.node(mesh=mesh, skin=0) for _ in range(16 * n)))
    return made


def instances(folder, n):
    made = gltf(folder)
    mesh = made.mesh()
    made.scene(*(made.node(mesh=mesh) for _ in range(512 * n)))
    return made


def text(folder, n):
    path = folder / "bomb.gltf"
    path.write_text('{"asset": {"version": "2.0"}, "extras": [' + ",".join(["[{}]"] * (8192 * n)) + "]}")
    return path


def materials(folder, n):
    path = folder / "bomb.obj"
    names = range(128 * n)
    (folder / "bomb.mtl").write_text("".join(f"newmtl m{name}\nKd 1 0 0\n" for name in names))
    faces = "".join(f"usemtl m{name}\nf 1 2 3\n" for name in names)
    path.write_text("mtllib bomb.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\n" + faces)
    return path


def mesh_text(folder, n):
    path = folder / "bomb.obj"
    corners = np.random.default_rng(0).integers(1, 999, (8192 * n, 3))
    vertices = [f"v {i} {i % 7} {i % 5}" for i in range(999)]
    path.write_text("\n".join([*vertices, *(f"f {a} {b} {c}" for a, b, c in corners)]))
    return path


def solids(folder, n):
    path = folder / "bomb.stl"
    facet = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
    path.write_text(f"solid a\n{facet}endsolid\n" * (64 * n))
    return path


def radiance(folder, n):
    """Runs of one color."""
    path = folder / "bomb.hdr"
    width = 512 * n
    height = 256
    runs = [bytes((128 + min(width - start, 127), 9)) for start in range(0, width, 127)]
    row = bytes((2, 2, width >> 8, width & 255)) + b"".join(4 * runs)
    path.write_bytes(b"#?RADIANCE\n\n-Y %d +X %d\n" % (height, width) + row * height)
    return path


def exr(folder, n):
    """Many channels of which three are used."""
    import OpenEXR

    path = folder / "bomb.exr"
    pixels = np.ones((128, 256 * n), np.float16)
    names = [f"layer.{number}" for number in range(60)] + ["R", "G", "B"]
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {name: pixels.copy() for name in names}).write(str(path))
    return path


def exr_tiles(folder, n):
    """A row of tiles that are higher than the picture: the library reads whole rows."""
    import OpenEXR

    path, tile = folder / "bomb.exr", b"tiles\0tiledesc\0" + struct.pack("<3I", 9, 64, 64)
    header = {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
    header["tiles"].xSize = header["tiles"].ySize = 64
    OpenEXR.File(header, {"Y": np.ones((1, 16_384), np.float16)}).write(str(path))
    path.write_bytes(path.read_bytes().replace(tile, tile[:-4] + struct.pack("<I", 128 * n)))
    return path


def exr_texture(folder, n):
    """Threads decode a picture whose header says that its one tile is high."""
    import OpenEXR

    path, tile = folder / "bomb.exr", b"tiles\0tiledesc\0" + struct.pack("<3I", 9, 32, 32)
    header = {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
    OpenEXR.File(header, {"RGB": np.ones((8, 16, 3), np.float16)}).write(str(path))
    made = gltf(folder)
    view = made.view(path.read_bytes().replace(tile, tile[:-4] + struct.pack("<I", 2**16 * n)))
    exr = {"EXT_texture_exr": {"source": made.add("images", bufferView=view, mimeType="image/x-exr")}}
    texture = {"index": made.add("textures", extensions=exr)}
    made.mesh({"TEXCOORD_0": [[0, 0]] * 3}, material=made.add("materials", normalTexture=texture))
    return made


BOMBS = (
    morphs,
    images,
    webp,
    progressive,
    animations,
    primitives,
    skins,
    instances,
    text,
    materials,
    mesh_text,
    solids,
    radiance,
    exr,
    exr_tiles,
    exr_texture,
)


def file_of(bomb, folder, n):
    made = bomb(folder, n)
    if isinstance(made, GltfWriter):
        made.save(made.path)
        return made.path
    return made


@pytest.mark.parametrize("bomb", BOMBS)
def test_loading_takes_what_is_charged(load, tmp_path, bomb):
    charged, taken, said = load(file_of(bomb, tmp_path, 16), 4 * 2**30)
    assert said == ""
    assert taken <= charged + SPARE, f"{taken / MIB:.0f} MiB, charged {charged / MIB:.0f}"


@pytest.mark.parametrize("bomb", BOMBS)
def test_more_than_the_budget_is_refused_before_it_is_taken(load, tmp_path, bomb):
    path = file_of(bomb, tmp_path, 16)
    charged, taken, said = load(path, 4 * MIB)
    assert charged <= 4 * MIB
    assert taken <= 4 * MIB + SPARE
    assert re.search(rf"{re.escape(str(tmp_path))}.* 4 MiB.*SOLARI_VK_LOAD_MEMORY", said)


def test_a_file_larger_than_the_budget_is_not_read(load, tmp_path):
    """A .glb that says 3 GiB, and is as large without having data."""
    path = tmp_path / "bomb.glb"
    with open(path, "wb") as file:
        file.write(struct.pack("<4sII", b"glTF", 2, 3 * 2**30))
        file.truncate(3 * 2**30)
    charged, taken, said = load(path, 2**30)
    assert (charged, taken < SPARE) == (12, True)
    assert "the file would take 3,072 MiB" in said


def test_files_of_images_are_charged(load, tmp_path):
    """Small pictures, with much after their end, are copied out of a file."""
    made = gltf(tmp_path)
    for number in range(3):
        image = made.add("images", bufferView=made.view(png(8, 8) + bytes(2**25)))
        texture = {"index": made.add("textures", source=image)}
        made.mesh({"TEXCOORD_0": [[0, 0]] * 3}, material=made.add("materials", normalTexture=texture, name=f"{number}"))
    _, taken, said = load(made.save(made.path), 144 * MIB)
    assert re.search("image 1: its file would take 64 MiB", said)
    assert taken <= 144 * MIB + SPARE, f"{taken / MIB:.0f} MiB"


@pytest.mark.parametrize("mode", [1, 3, 5, 6])
def test_lines_and_strips_are_charged_before_they_are_made(load, tmp_path, mode):
    made = gltf(tmp_path)
    made.mesh(indices=made.accessor(np.zeros((2**24, 1)), "u1"), mode=mode)
    charged, taken, said = load(made.save(made.path), 160 * MIB)
    assert re.search("16,777,216 points or lines|its mesh", said)
    assert charged <= 160 * MIB
    assert taken <= 160 * MIB + SPARE, f"{taken / MIB:.0f} MiB"


def test_time_ends_loading(tmp_path):
    with pytest.raises(sv.SolariError, match=r"longer than it may.*SOLARI_VK_LOAD_SECONDS"):
        sv.load(file_of(instances, tmp_path, 1), seconds=1e-6)


@pytest.mark.parametrize("value", ["12 KiB", "0.00001GB"])
def test_the_environment_sets_the_budget(tmp_path, monkeypatch, value):
    path = GltfWriter(tmp_path / "few.glb")
    path.mesh({"POSITION": [*TRIANGLE, *np.random.default_rng(0).normal(size=(999, 3))]})
    monkeypatch.setenv("SOLARI_VK_LOAD_MEMORY", value)
    with pytest.raises(sv.SolariError, match="SOLARI_VK_LOAD_MEMORY"):
        path.load()
    assert parse_size("1.5 MiB", "") == 3 * 2**19
    monkeypatch.setenv("SOLARI_VK_LOAD_MEMORY", "much")
    with pytest.raises(sv.SolariError, match="give a size such as 4GiB, not 'much'"):
        path.load()


@pytest.mark.posix
@pytest.mark.parametrize("name", ["pipe.glb", "pipe.obj", "pipe.hdr", "pipe.exr", "pipe.png"])
def test_pipes_are_refused_at_once(tmp_path, name):
    os.mkfifo(tmp_path / name)
    read = sv.load if name.endswith(("glb", "obj")) else sv.Environment
    with pytest.raises(sv.SolariError, match="not a readable file: give the path of a regular file"):
        read(tmp_path / name)


URIS = {
    "data": "data:application/octet-stream," + "%41" * (4 << 20),
    "base64": "data:;base64," + "%41" * (4 << 20),
    "a path": "%41" * (4 << 20),
    "one emoji": "data:," + "x" * (12 << 20) + "\U0001f600",
    "one emoji in base64": "data:;base64," + "A" * (12 << 20) + "\U0001f600",
}


@pytest.mark.parametrize("name", URIS)
@pytest.mark.parametrize("escaped", [False, True])
def test_a_uri_takes_what_is_charged(load, tmp_path, name, escaped):
    document = {"asset": {"version": "2.0"}, "buffers": [{"byteLength": 36, "uri": URIS[name]}], "scene": 0}
    document |= {"bufferViews": [{"buffer": 0, "byteLength": 36}], "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}]}
    document["accessors"] = [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}]
    document["meshes"] = [{"primitives": [{"attributes": {"POSITION": 0}}]}]
    path = tmp_path / "a.gltf"
    path.write_text(json.dumps(document, ensure_ascii=escaped), encoding="utf-8")
    charged, taken, _ = load(path, 4096 * MIB)
    assert taken <= charged + SPARE
    _, taken, said = load(path, 40 * MIB)
    assert taken <= 40 * MIB + SPARE, said
