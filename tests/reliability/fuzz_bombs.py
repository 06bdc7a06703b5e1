"""Files that ask for as much memory and time as they can for their size, one function for each format.

A function takes values that `draw` chooses, and writes files into a folder; it returns the one to load.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from hypothesis import reject
from hypothesis import strategies as st
from support.files import KTX2_ETC1S, KTX2_UASTC, KTX2_UASTC_ZSTD, GltfWriter, image_file, ktx2_file

Draw = Callable[[st.SearchStrategy[Any]], Any]
RNG = np.random.default_rng(0)
FEW = st.sampled_from([1, 1, 1, 16, 500, 4000])  # of what the file names one by one
ROWS = st.sampled_from([3, 300, 30_000])  # that the file has
HUGE = st.sampled_from([0, 300, 30_000, 2**20, 2**22, 2**24, 2**31 - 1, 2**32 - 1, 2**53])  # that it only declares
SIDE = st.sampled_from([1, 64, 1000, 4096, 16_384, 65_500])
FILLED = 2**25  # pixels of a picture that are really there


def empty(made: GltfWriter, count: int, kind: str = "VEC3", component: int = 5126) -> int:
    """An accessor without data."""
    return made.add("accessors", componentType=component, count=count, type=kind)


def gltf(draw: Draw, folder: Path) -> Path:
    """Each list of the format long, each accessor large, and all shared as often as the format allows."""
    return GltfBomb(draw).made.save(folder / "bomb.glb")


class GltfBomb:
    """The glTF file of `gltf`, made step by step: a step draws how much the file has of one thing."""

    def __init__(self, draw: Draw) -> None:
        self.draw = draw
        self.made = GltfWriter()
        self.rows = draw(ROWS)
        materials = self.add_materials()
        mesh = self.add_mesh(self.vertex_attributes(), self.morph_targets(), materials)
        self.add_nodes(mesh)
        self.add_animations()

    def shared(self, kind: str, width: int) -> int:
        """An accessor with rows, or one that only declares them."""
        if self.draw(st.integers(0, 3)):
            return self.made.accessor(RNG.normal(size=(self.rows, width)))
        return empty(self.made, self.draw(st.sampled_from([self.rows, self.draw(HUGE)])), kind)

    def some(self, count: int) -> range:
        """This many numbers, or none."""
        return range(count if self.draw(st.booleans()) else 0)

    def add_materials(self) -> list[int]:
        made, draw = self.made, self.draw
        materials = [made.add("materials", name=f"m{n}") for n in self.some(draw(FEW))]
        if materials and draw(st.booleans()):
            source = made.add("images", bufferView=made.view(png(draw)))
            for material in materials:
                texture = made.add("textures", source=source)
                made.json["materials"][material]["emissiveTexture"] = {"index": texture}
                made.json["materials"][material]["normalTexture"] = {"index": texture, "texCoord": material % 2}
        return materials

    def vertex_attributes(self) -> dict[str, int]:
        attributes = {"POSITION": self.shared("VEC3", 3)}
        for name, kind, width in (
            ("NORMAL", "VEC3", 3),
            ("TEXCOORD_0", "VEC2", 2),
            ("TEXCOORD_1", "VEC2", 2),
            ("COLOR_0", "VEC4", 4),
        ):
            if self.draw(st.booleans()):
                attributes[name] = self.shared(kind, width)
        for number in self.some(self.draw(st.sampled_from([1, 8, 64]))):
            attributes[f"JOINTS_{number}"] = empty(self.made, self.rows, "VEC4", 5123)
            attributes[f"WEIGHTS_{number}"] = self.made.accessor(np.tile([1, 0, 0, 0], (self.rows, 1)))
        return attributes

    def morph_targets(self) -> list[dict[str, int]]:
        target = {"POSITION": self.shared("VEC3", 3), "NORMAL": self.shared("VEC3", 3)}
        return [target for _ in self.some(self.draw(FEW))]

    def add_mesh(self, attributes: dict[str, int], targets: list[dict[str, int]], materials: list[int]) -> int:
        """A mesh of primitives that share their attributes, with variants of their materials."""
        parts = []
        for number in range(self.draw(FEW)):
            part: dict[str, Any] = {"attributes": attributes, "targets": targets, "mode": self.draw(st.integers(4, 6))}
            if self.draw(st.booleans()):
                part["indices"] = self.add_indices()
            if materials:
                part["material"] = materials[number % len(materials)]
            parts.append(part)
        variants = [{"name": f"v{n}"} for n in self.some(self.draw(FEW))]
        if variants and materials:
            self.made.json["extensions"] = {"KHR_materials_variants": {"variants": variants}}
            mappings = [{"material": 0, "variants": [*range(len(variants))]}]
            parts[0]["extensions"] = {"KHR_materials_variants": {"mappings": mappings}}
        return self.made.add("meshes", primitives=parts)

    def add_indices(self) -> int:
        """Indices without data, or with data for three of them alone."""
        indices = empty(self.made, self.draw(HUGE), "SCALAR", 5125)
        if self.draw(st.booleans()):
            self.made.json["accessors"][-1]["sparse"] = {
                "count": 3,
                "values": {"bufferView": self.made.view(struct.pack("<3I", 0, 1, 2))},
                "indices": {"bufferView": self.made.view(bytes((0, 1, 2))), "componentType": 5121},
            }
        return indices

    def add_nodes(self, mesh: int) -> None:
        """Nodes of the mesh, with joints and instances, and nodes with a camera and a light."""
        made, draw = self.made, self.draw
        joints = [made.node() for _ in self.some(draw(FEW))]
        node: dict[str, Any] = {"mesh": mesh}
        if joints:
            node["skin"] = made.add("skins", joints=joints * draw(st.sampled_from([1, 4])))
            if draw(st.booleans()):
                made.json["skins"][0]["inverseBindMatrices"] = empty(made, draw(HUGE), "MAT4")
        if draw(st.booleans()):
            repeats = made.accessor(np.ones((self.rows, 3))) if draw(st.booleans()) else empty(made, draw(HUGE))
            node["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": repeats}}}
        self.nodes = [made.node(**node) for _ in range(draw(FEW))]
        made.json.setdefault("extensions", {})["KHR_lights_punctual"] = {"lights": [{"type": "point"}]}
        made.add("cameras", type="perspective", perspective={"yfov": 1, "znear": 0.1})
        light = {"KHR_lights_punctual": {"light": 0}}
        self.nodes += [made.node(camera=0, extensions=light) for _ in self.some(draw(FEW))]
        made.scene(*joints, *self.nodes)

    def add_animations(self) -> None:
        made = self.made
        for _ in self.some(self.draw(FEW)):
            sampler = {"input": made.accessor(np.arange(self.rows)[:, None]), "output": self.shared("VEC3", 3)}
            path = self.draw(st.sampled_from(["translation", "weights"]))
            channels = [{"sampler": 0, "target": {"node": self.nodes[0], "path": path}}] * self.draw(FEW)
            made.add("animations", samplers=[sampler], channels=channels)
            if len(made.data) > 2**24:
                break


# ---- pictures ---------------------------------------------------------------------------------------


def png(draw: Draw) -> bytes:
    """Of one color, in all kinds of pixels; or only the header of one that is larger."""
    width, height = draw(SIDE), draw(SIDE)
    depth, color = draw(st.sampled_from([(8, 6), (8, 2), (8, 0), (1, 0), (16, 0), (16, 2), (16, 6), (8, 3), (16, 4)]))
    bits = depth * {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}[color]
    rows, packer = bytes(-(-width * bits // 8) + 1), zlib.compressobj(1)
    there = height if width * height <= FILLED else 1
    data = b"".join(packer.compress(rows) for _ in range(there)) + packer.flush()
    chunks = [(b"IHDR", struct.pack(">2I5B", width, height, depth, color, 0, 0, draw(st.sampled_from([0, 0, 1]))))]
    chunks += [(b"PLTE", bytes(768)), (b"tRNS", bytes(256))] if color == 3 else []
    if draw(st.booleans()):
        chunks.append((b"zTXt", b"a\0\0" + zlib.compress(bytes(2 ** draw(st.integers(10, 26))), 1)))
    chunks += [(b"IDAT", data), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body)) for name, body in chunks
    )


def jpeg(draw: Draw) -> bytes:
    """Progressive ones keep all coefficients while they are decoded."""
    side = draw(st.sampled_from([8, 512, 2048, 4096]))
    mode = draw(st.sampled_from(["L", "RGB", "CMYK"]))
    from PIL import Image

    data = bytearray(image_file(Image.new(mode, (side, side)), "JPEG", progressive=draw(st.booleans())))
    start = max(data.find(b"\xff\xc0"), data.find(b"\xff\xc2"))
    if draw(st.booleans()):
        struct.pack_into(">2H", data, start + 5, draw(SIDE), draw(SIDE))
    return bytes(data)


def webp(draw: Draw) -> bytes:
    pixels = np.zeros((draw(st.sampled_from([8, 4096])), 4096, draw(st.sampled_from([3, 4]))), np.uint8)
    data = bytearray(image_file(pixels, "WEBP", lossless=draw(st.booleans()), method=0))
    start = data.find(b"VP8 ") + 14
    if start > 14 and draw(st.booleans()):
        struct.pack_into("<2H", data, start, draw(st.integers(1, 16_383)), draw(st.integers(1, 16_383)))
    return bytes(data)


def dds(draw: Draw) -> bytes:
    """Of one color; or the header of another size."""
    from PIL import Image

    pixels = Image.new("RGBA", (4096, draw(st.sampled_from([8, 4096]))))
    form = draw(st.sampled_from([{}, {"pixel_format": "DXT1"}, {"pixel_format": "BC5"}]))
    data = bytearray(image_file(pixels.convert("RGB") if form else pixels, "DDS", **form))
    if draw(st.booleans()):
        struct.pack_into("<2I", data, 12, draw(SIDE), draw(SIDE))
    return bytes(data)


def ktx2(draw: Draw) -> bytes:
    """Levels that expand to more than the picture, and headers that say other sizes than the data."""
    files = [KTX2_ETC1S, KTX2_UASTC, KTX2_UASTC_ZSTD]
    which = draw(st.integers(0, 3))
    if which:
        data = bytearray(files[which - 1])
    else:
        level = bytes(2 ** draw(st.integers(10, 27)))
        data = bytearray(ktx2_file(np.zeros((1, 1, 4)), 37, 3, level))
    if draw(st.booleans()):
        struct.pack_into("<2I", data, 20, draw(SIDE), draw(SIDE))
    if draw(st.booleans()):
        struct.pack_into("<Q", data, 96, draw(HUGE))
    return bytes(data)


def image(draw: Draw, folder: Path) -> Path:
    """A scene with many of one kind of image."""
    made = GltfWriter()
    kind = draw(st.sampled_from([png, jpeg, webp, dds, ktx2, exr]))
    file = exr(draw, folder).read_bytes() if kind is exr else kind(draw)
    for _ in range(draw(st.sampled_from([1, 2, 8]))):
        picture = {"source": made.add("images", bufferView=made.view(file))}
        named = {ktx2: "KHR_texture_basisu", exr: "EXT_texture_exr", dds: "MSFT_texture_dds"}.get(kind)
        texture = {"index": made.add("textures", **({"extensions": {named: picture}} if named else picture))}
        made.mesh({"TEXCOORD_0": [[0, 0]] * 3}, material=made.add("materials", normalTexture=texture))
    return made.save(folder / "bomb.glb")


def hdr(draw: Draw, folder: Path) -> Path:
    width = draw(SIDE)
    height = draw(SIDE)
    path = folder / "bomb.hdr"
    row = bytes((2, 2, width >> 8, width & 255)) + (b"\xff\x09" * (width // 127) + bytes((128 + width % 127, 9))) * 4
    lines = b"EXPOSURE=1\n" * draw(FEW)
    data = row * (height if width * height <= FILLED else 1)
    path.write_bytes(b"#?RADIANCE\n%b\n-Y %d +X %d\n%b" % (lines, height, width, data))
    return path


def exr(draw: Draw, folder: Path) -> Path:
    """Many channels, and a data window or tiles that are larger than the picture that is there."""
    path, count = folder / "bomb.exr", draw(st.sampled_from([1, 60, 500]))
    width = draw(st.sampled_from([8, 1000, 16_384]))
    height = min(draw(st.sampled_from([1, 32, 256])), max(FILLED // (width * count), 1))
    kind = draw(st.sampled_from([OpenEXR.scanlineimage, OpenEXR.tiledimage]))
    compressions = "NO", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44A", "DWAA", "DWAB"
    compression = getattr(OpenEXR, f"{draw(st.sampled_from(compressions))}_COMPRESSION")
    header: dict[str, Any] = {"compression": compression, "type": kind}
    if kind == OpenEXR.tiledimage:
        header["tiles"] = OpenEXR.TileDescription()
    pixels = np.zeros((height, width), np.float16)
    try:
        OpenEXR.File(header, {f"l{n}.A": pixels.copy() for n in range(count)} | {"Y": pixels}).write(str(path))
    except MemoryError:  # of the writer
        reject()
    data = bytearray(path.read_bytes())
    for name, form, skipped in ((b"dataWindow\0box2i\0", "<2i", 12), (b"tiles\0tiledesc\0", "<2I", 4)):
        place = data.find(name)
        if place >= 0 and draw(st.integers(0, 3)) == 0:
            struct.pack_into(form, data, place + len(name) + skipped, draw(SIDE), draw(SIDE))
    path.write_bytes(data)
    return path


# ---- meshes and cameras -----------------------------------------------------------------------------

CORNERS = b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"


def obj(draw: Draw, folder: Path) -> Path:
    """Lines of one kind, many times, after a triangle; each number at the end counts up."""
    lines = draw(
        st.lists(
            st.sampled_from(
                [
                    b"f 1 2 3\n",
                    b"f -1 -2 -3\n",
                    b"f 1 2 3 1 2 3\n",
                    b"v 0 0 0\n",
                    b"vt 0 0\n",
                    b"vn 0 0 1\n",
                    b"o a%d\n",
                    b"g a%d\n",
                    b"usemtl m%d\n",
                    b"mtllib bomb.mtl\n",
                    b"s 1\n",
                    b"l 1 2\n",
                    b"\n",
                    b"f\n",
                    b"#\n",
                    b"f 1//1 2//2 3//3\n",
                ]
            ),
            min_size=1,
            max_size=3,
        )
    )
    count = draw(st.sampled_from([1, 1000, 30_000, 300_000]))
    line = b"".join(lines)
    body = b"".join(line.replace(b"%d", b"%d" % n) for n in range(count)) if b"%d" in line else line * count
    long = b"f" + b" 1 2 3" * draw(st.sampled_from([1, 100_000])) + b"\n"
    (folder / "bomb.mtl").write_bytes(b"".join(b"newmtl m%d\nKd 1 0 0\n" % n for n in range(draw(FEW))))
    path = folder / "bomb.obj"
    path.write_bytes(b"mtllib bomb.mtl\n" + CORNERS + body + long)
    return path


def ply(draw: Draw, folder: Path) -> Path:
    """A header that declares more than there is, or much of it."""
    path, kind = folder / "bomb.ply", draw(st.sampled_from(["ascii", "binary_little_endian"]))
    more, count = draw(st.sampled_from(["double", "uchar"])), draw(st.sampled_from([0, 0, 16, 4000]))
    properties = ["float x", "float y", "float z", *(f"{more} p{number}" for number in range(count))]
    vertices, faces = (draw(st.sampled_from([few, few, 30_000, draw(HUGE)])) for few in (3, 1))
    lists = draw(st.sampled_from([*["list uchar int vertex_indices"] * 4, "list uint int vertex_indices", "uchar a"]))
    header = [f"element vertex {vertices}", *(f"property {text}" for text in properties)]
    header += [f"element face {faces}", f"property {lists}"]
    for number in range(draw(st.sampled_from([0, 0, 0, 4, 1000]))):
        header += [f"element e{number} {draw(HUGE)}" if number < 4 else f"element e{number} 0", "property uchar a"]
    start = f"ply\nformat {kind} 1.0\n" + "\n".join(header) + "\nend_header\n"
    corners = np.eye(3, max(len(properties), 3), dtype=int)
    rows = [" ".join(map(str, corner)).encode() + b"\n" * draw(st.sampled_from([1, 1, 2])) for corner in corners]
    if kind != "ascii":
        sizes = [{"float": "f", "double": "d", "uchar": "B"}[text.split()[0]] for text in properties]
        rows = [struct.pack("<" + "".join(sizes), *corner) for corner in corners.tolist()]
    row = b"".join(rows)
    packed = struct.pack("<B3i", 3, 0, 1, 2)
    triangle = b"3 0 1 2\n" if kind == "ascii" else draw(st.sampled_from([packed, packed, b"\xff" * 4]))
    body = row * min(vertices // 3, 10_000, 2**24 // len(row)) + triangle * min(faces, 30_000)
    path.write_bytes(start.encode() + body)
    return path


def stl(draw: Draw, folder: Path) -> Path:
    path, count = folder / "bomb.stl", draw(st.sampled_from([1, 1000, 100_000]))
    facet = b"facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
    path.write_bytes(
        draw(
            st.sampled_from(
                [
                    b"solid a\n" + facet * count + b"endsolid\n",
                    (b"solid a\n" + facet * draw(st.sampled_from([0, 1])) + b"endsolid\n") * count,
                    b"solid\nendsolid\n" * count,
                    bytes(80) + struct.pack("<I", draw(HUGE) % 2**32) + bytes(range(50)) * count,
                ]
            )
        )
    )
    return path


def poses(draw: Draw, folder: Path) -> Path:
    """Lists of poses, frames of transforms.json, and JSON that is large without saying anything."""
    path, count = folder / "bomb.json", draw(st.sampled_from([2, 1000, 20_000, 400_000]))
    item = draw(
        st.sampled_from(
            [
                "[]",
                "{}",
                "0",
                "[[[[[]]]]]",
                *['{"position":[1,1,1],"target":[0,0,0]}'] * 4,
                '{"transform_matrix":[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}',
            ]
        )
    )
    items = ",".join([item] * count)
    lens = json.dumps({"w": draw(HUGE), "h": draw(HUGE), "fl_x": draw(HUGE)})[1:-1]
    path.write_text(
        draw(
            st.sampled_from(
                [
                    f"[{items}]",
                    f'{{"frames":[{items}],{lens}}}',
                    f'{{"frames":[{items}],"camera_angle_x":1}}',
                    "[" * count,
                    f'[{{"time":0,"position":[1,1,1],"target":[0,0,0]}},{{"time":{draw(HUGE)},"position":[2,1,1],"target":[0,0,0]}}]',
                ]
            )
        )
    )
    return path


BOMBS = {f"{made.__name__} bomb": made for made in (gltf, image, hdr, exr, obj, ply, stl, poses)}
