"""Files for tests: assets, and writers of glTF (plain and compressed), KTX2, Radiance and OpenEXR files."""

import base64
import io
import json
import os
import re
import struct
import zlib
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import DracoPy
import meshopt
import numpy as np
import OpenEXR
import pytest

from solari_vk.base.errors import SolariError
from solari_vk.scene.files.gltf import load_gltf
from solari_vk.scene.files.gltf.saving.content import glb
from solari_vk.scene.files.libraries import zstd

# Files of others that tests read: assets/ beside the checkout, or the folder that SOLARI_VK_ASSETS names.
_FOLDER = os.environ.get("SOLARI_VK_ASSETS")
ASSETS = Path(_FOLDER) if _FOLDER else Path(__file__).parents[3] / "shared" / "assets"


def find_asset(name):
    """The path of an asset; without it the test is skipped."""
    if not (ASSETS / name).exists():
        pytest.skip(f"no {name} among the assets")
    return ASSETS / name


# ---- glTF ----


COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
TRIANGLE = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]


class GltfWriter:
    """A glTF file: `json` (which tests may change) and `data`, its only buffer. `load` saves it to `path` first."""

    def __init__(self, path=None):
        self.path = path
        self.data = bytearray()
        self.json = {"asset": {"version": "2.0"}}

    def add(self, kind, **fields):
        """Append an object to a list ("nodes", "meshes", ...) and return its number."""
        self.json.setdefault(kind, []).append(fields)
        return len(self.json[kind]) - 1

    def view(self, data, **fields):
        self.data.extend(b"\0" * (-len(self.data) % 4))
        offset = len(self.data)
        self.data.extend(data)
        return self.add("bufferViews", buffer=0, byteOffset=offset, byteLength=len(data), **fields)

    def accessor(self, values, dtype="f4", stride=None, **fields):
        """An accessor of rows; `stride` spreads them out."""
        array = np.array(values, "<" + dtype)
        rows = array.reshape(len(array), -1)
        size = rows.shape[1] * rows.itemsize
        spread = np.full((len(rows), stride or size), 0xAB, np.uint8)
        spread[:, :size] = np.ascontiguousarray(rows).view(np.uint8)
        view = self.view(spread.tobytes(), **({"byteStride": stride} if stride else {}))
        fields = {"type": KINDS[rows.shape[1]], **fields}
        return self.add("accessors", bufferView=view, componentType=COMPONENTS[dtype], count=len(rows), **fields)

    def mesh(self, attributes=None, indices=None, **fields):
        """A mesh of one primitive; attributes are accessor numbers or rows of floats."""
        attributes = {"POSITION": TRIANGLE, **(attributes or {})}
        numbers = {k: v if isinstance(v, int) else self.accessor(v) for k, v in attributes.items() if v is not None}
        primitive = {"attributes": numbers, **fields}
        if indices is not None:
            primitive["indices"] = indices if isinstance(indices, int) else self.accessor(indices, "u2")
        return self.add("meshes", primitives=[primitive])

    def node(self, **fields):
        return self.add("nodes", **fields)

    def animate(self, node, path, times, values, interpolation="LINEAR", **target):
        """Add a channel to the last clip, "clip" where there is none."""
        clip = self.json.setdefault("animations", [{"channels": [], "samplers": [], "name": "clip"}])[-1]
        target |= {"path": path} | ({} if node is None else {"node": node})
        clip["channels"].append({"sampler": len(clip["samplers"]), "target": target})
        output = values if isinstance(values, int) else self.accessor(values)
        clip["samplers"].append({"input": self.accessor(times), "output": output, "interpolation": interpolation})

    def clip(self, name):
        """A clip without channels yet."""
        return self.add("animations", channels=[], samplers=[], name=name)

    def image(self, pixels, format="PNG", **options):
        """A texture (image, no sampler) of pixels (h, w, c)."""
        file = image_file(pixels, format, **options)
        image = self.add("images", bufferView=self.view(file), mimeType="image/" + format.lower())
        return self.add("textures", source=image)

    def scene(self, *nodes):
        self.json["scene"] = self.add("scenes", nodes=list(nodes))

    def finish(self):
        """The JSON with the buffer; by default with a node for each mesh, and a scene of all nodes."""
        if self.data:
            self.json.setdefault("buffers", [{"byteLength": len(self.data)}])
        if "meshes" in self.json:
            self.json.setdefault("nodes", [{"mesh": number} for number in range(len(self.json["meshes"]))])
        if "scenes" not in self.json and "nodes" in self.json:
            children = {c for node in self.json["nodes"] for c in node.get("children", [])}
            self.scene(*(n for n in range(len(self.json["nodes"])) if n not in children))
        return self.json

    def glb(self):
        return glb(json.dumps(self.finish()).encode(), bytes(self.data))

    def load(self, **options):
        return load_gltf(self.save(self.path), **options)

    def load_with_loss(self, message):
        """The scene of a file of which a part is wrong, which is reported; with `strict` it is an error."""
        with pytest.raises(SolariError, match=message):
            self.load(strict=True)
        scene = self.load()
        assert re.search(message, "\n".join(scene.warnings)), scene.warnings
        return scene

    def save(self, path, packing="glb"):
        """Write as "glb", "embedded" (a data URI) or "external" (a .bin beside it)."""
        if packing == "glb":
            path.write_bytes(self.glb())
            return path
        content = self.finish()
        if packing == "embedded":
            uri = "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()
        else:
            uri = path.stem + ".bin"
            path.with_suffix(".bin").write_bytes(self.data)
        content["buffers"][0]["uri"] = uri
        path.write_text(json.dumps(content))
        return path


def image_file(picture, format="PNG", **options):
    """The bytes of a file. picture: a PIL image, or pixels (h, w, c)."""
    from PIL import Image

    file = io.BytesIO()
    image = picture if isinstance(picture, Image.Image) else Image.fromarray(np.asarray(picture, np.uint8))
    image.save(file, format=format, **options)
    return file.getvalue()


# ---- glTF files of a wavy sheet: plain, and compressed by meshopt and by Draco ----


SHEET_SIDE = 12
MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
DRACO = "KHR_draco_mesh_compression"


def wavy_sheet():
    """Positions, normals, uvs and triangles of the sheet."""
    u, v = np.indices((SHEET_SIDE, SHEET_SIDE)).reshape(2, -1) / (SHEET_SIDE - 1)
    positions = np.stack([u, v, 0.1 * np.sin(6 * u)], 1)
    normals = np.stack([-0.6 * np.cos(6 * u), 0 * u, 1 + 0 * u], 1)
    corner = np.arange(SHEET_SIDE * (SHEET_SIDE - 1)).reshape(-1, SHEET_SIDE)[:, :-1].ravel()
    triangles = np.r_[
        np.c_[corner, corner + SHEET_SIDE, corner + 1], np.c_[corner + 1, corner + SHEET_SIDE, corner + SHEET_SIDE + 1]
    ]
    return positions, normals / np.linalg.norm(normals, axis=1, keepdims=True), np.stack([u, v], 1), triangles


def corners(scene):
    """Positions, normals and uvs of all corners of the only mesh, sorted by position: compression changes the order."""
    mesh = scene.instances[0].mesh
    found = np.concatenate([mesh.positions, mesh.normals, mesh.uvs], 1)[mesh.triangles.reshape(-1)]
    return found[np.lexsort(found[:, :3].round(2).T)]


def textured(writer):
    """A material that needs uvs."""
    return {"material": writer.add("materials", emissiveTexture={"index": writer.image(np.zeros((1, 1, 3)))})}


def plain_file(writer):
    positions, normals, uvs, triangles = wavy_sheet()
    attributes = {"POSITION": positions, "NORMAL": normals, "TEXCOORD_0": uvs}
    writer.mesh(attributes, triangles.reshape(-1), **textured(writer))


def meshopt_accessor(writer, rows, dtype, kind, mode="ATTRIBUTES", extension=MESHOPT[0], filter=None, **fields):
    """An accessor of a compressed view of the second buffer, which has no data. rows: before compression."""
    rows = np.ascontiguousarray(rows)
    size = rows.nbytes // len(rows)
    stored = writer.view(meshopt.encode_gltf_buffer(rows, mode, int("KHR" in extension)))
    part = {**writer.json["bufferViews"].pop(stored), "byteStride": size, "count": len(rows), "mode": mode}
    part |= {"filter": filter} if filter else {}
    stride = {"byteStride": size} if mode == "ATTRIBUTES" else {}
    view = writer.add("bufferViews", buffer=1, byteLength=rows.nbytes, extensions={extension: part}, **stride)
    fields |= {"count": len(rows), "componentType": COMPONENTS[dtype], "type": kind}
    return writer.add("accessors", bufferView=view, **fields)


def meshopt_file(writer, extension=MESHOPT[0]):
    positions, normals, uvs, triangles = wavy_sheet()
    exponents = meshopt.encode_filter_exp(positions.astype(np.float32), 20)
    octahedra = meshopt.encode_filter_oct(np.c_[normals, np.ones(len(normals))], 4, 8)
    given = {"extension": extension}
    attributes = {
        "POSITION": meshopt_accessor(writer, exponents, "f4", "VEC3", filter="EXPONENTIAL", **given),
        "NORMAL": meshopt_accessor(writer, octahedra, "i1", "VEC3", filter="OCTAHEDRAL", normalized=True, **given),
        "TEXCOORD_0": meshopt_accessor(writer, uvs.astype(np.float32), "f4", "VEC2", **given),
    }
    numbers = triangles.reshape(-1).astype(np.uint16)
    indices = meshopt_accessor(writer, numbers, "u2", "SCALAR", "TRIANGLES", **given)
    writer.mesh(attributes, indices, **textured(writer))
    writer.json["extensionsRequired"] = [extension]
    writer.finish()
    writer.json["buffers"].append({"byteLength": 2**20, "extensions": {extension: {"fallback": True}}})


def draco_file(writer, change=bytes, plain=False, names=(), **options):
    """The extension of a file with one compressed primitive. plain: whether the accessors have data of their own too.

    change: of the compressed data. names: of attributes without a number. options: of the encoder.
    """
    positions, normals, uvs, triangles = wavy_sheet()
    colors = np.tile(np.array([65535, 0, 32768, 0], np.uint16), (len(positions), 1))
    packed = DracoPy.encode(
        positions,
        triangles.astype(np.uint32),
        quantization_bits=16,
        normals=normals,
        tex_coord=uvs,
        generic_attributes={3: colors, **dict.fromkeys(names, colors)},
        **options,
    )
    numbers = {item["attribute_type"]: item["unique_id"] for item in DracoPy.decode(packed).attributes}
    kinds = {
        "POSITION": DracoPy.AttributeType.POSITION,
        "NORMAL": DracoPy.AttributeType.NORMAL,
        "TEXCOORD_0": DracoPy.AttributeType.TEX_COORD,
    }
    ids = {name: numbers[kind] for name, kind in kinds.items()} | {"COLOR_0": 3}
    view = writer.view(change(packed))

    def accessor(values, kind, dtype="f4", **fields):
        if plain:
            return writer.accessor(values, dtype, **fields)
        return writer.add("accessors", count=len(values), componentType=COMPONENTS[dtype], type=kind, **fields)

    attributes = {
        "POSITION": accessor(positions, "VEC3"),
        "NORMAL": accessor(normals, "VEC3"),
        "TEXCOORD_0": accessor(uvs, "VEC2"),
        "COLOR_0": accessor(colors, "VEC4", "u2", normalized=True),
    }
    extension = {"bufferView": view, "attributes": ids}
    indices = accessor(triangles.reshape(-1), "SCALAR", "u2")
    writer.mesh(attributes, indices, extensions={DRACO: extension}, **textured(writer))
    if not plain:
        writer.json["extensionsRequired"] = [DRACO]
    return extension


# ---- KTX2: of Basis Universal, and of plain pixels ----


# Written by the encoder of Basis Universal 2.10. 8 x 4 pixels: left (200, 40, 40, 255), right (40, 40, 200, 128).
KTX2_ETC1S = base64.b64decode(
    "q0tUWCAyMLsNChoKAAAAAAEAAAAIAAAABAAAAAAAAAAAAAAAAQAAAAEAAAABAAAAaAAAADwAAACkAAAAJAAAAMgAAAAAAAAAkgAA"
    "AAAAAABaAQAAAAAAAAIAAAAAAAAAAAAAAAAAAAA8AAAAAAAAAAIAOACjAQIAAwMAAAgIAAAAAAAAAAA/AAAAAAAAAAAA/////0AA"
    "Pw8AAAAAAAAAAP////8fAAAAS1RYd3JpdGVyAEJhc2lzIFVuaXZlcnNhbCAyLjEwAAAEAAMAMQAAAA0AAAAsAAAAAAAAAAAAAAAA"
    "AAAAAQAAAAEAAAABAAAAFMBEAAAAAAAA4gEIMBEAAAAAAIAsOLABTAkAAAAAAEGR5AERgCgAAgAAAJAY4EOuAFRVVVUFAAAAqKqq"
    "qgIAwUQAAAAAAADyX40AmAAQAAAAAECUAJgAIAAAAACB4gBgAgAAAAAAAAEEAHYI"
)
KTX2_UASTC_ZSTD = base64.b64decode(
    "q0tUWCAyMLsNChoKAAAAAAEAAAAIAAAABAAAAAAAAAAAAAAAAQAAAAEAAAACAAAAaAAAACwAAACUAAAAJAAAAAAAAAAAAAAAAAAA"
    "AAAAAAC4AAAAAAAAACkAAAAAAAAAIAAAAAAAAAAsAAAAAAAAAAIAKACmAQIAAwMAABAAAAAAAAAAAAB/AwAAAAAAAAAA/////x8A"
    "AABLVFh3cml0ZXIAQmFzaXMgVW5pdmVyc2FsIDIuMTAAACi1L/0gIAEBABcZBeU/yMYAAAAAAAAAAAAXBQUZMDAmAwAAAAAAAAAA"
)
KTX2_UASTC = base64.b64decode(
    "q0tUWCAyMLsNChoKAAAAAAEAAAAIAAAABAAAAAAAAAAAAAAAAQAAAAEAAAAAAAAAaAAAACwAAACUAAAALAAAAAAAAAAAAAAAAAAA"
    "AAAAAADAAAAAAAAAACAAAAAAAAAAIAAAAAAAAAAsAAAAAAAAAAIAKACmAQIAAwMAABAAAAAAAAAAAAB/AwAAAAAAAAAA/////x8A"
    "AABLVFh3cml0ZXIAQmFzaXMgVW5pdmVyc2FsIDIuMTAAAAQAAAB/fwAAFxkF5T/IxgAAAAAAAAAAABcFBRkwMCYDAAAAAAAAAAA="
)


def ktx2_file(pixels, vk_format, scheme=0, level=None, **fields):
    """A file of 8-bit pixels (height, width, channels). level: other bytes for them. fields: of the header."""
    pixels = np.asarray(pixels, np.uint8)
    data = pixels.tobytes() if level is None else level
    if scheme:
        data = zlib.compress(data) if scheme == 3 else zstd("tests").compress(data)
    height, width = pixels.shape[:2]
    header = {
        "format": vk_format,
        "type_size": 1,
        "width": width,
        "height": height,
        "depth": 0,
        "layers": 0,
        "faces": 1,
        "levels": 1,
        "scheme": scheme,
        **fields,
    }
    index = struct.pack("<4I2Q", 0, 0, 0, 0, 0, 0) + struct.pack("<3Q", 104, len(data), pixels.nbytes)
    return b"\xabKTX 20\xbb\r\n\x1a\n" + struct.pack("<9I", *header.values()) + index + data


# ---- pictures of any brightness: Radiance (.hdr) and OpenEXR ----


def rgbe_codes(colors):
    """The codes (H, W, 4) of colors (H, W, 3), as Radiance writes them."""
    largest = colors.max(axis=-1)
    mantissa, exponent = np.frexp(largest)
    scale = np.where(largest > 0, mantissa * 256 / np.where(largest > 0, largest, 1), 0)
    codes = np.concatenate([colors * scale[..., None], (exponent + 128)[..., None]], axis=-1).astype(np.uint8)
    codes[largest == 0] = 0
    return codes


def hdr_file(codes, runs=True, header=b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n"):
    """A Radiance file of codes (H, W, 4), flat or with run lengths."""
    height, width = codes.shape[:2]
    data = header + b"\n-Y %d +X %d\n" % (height, width)
    if not runs:
        return data + codes.tobytes()
    for row in codes:
        data += bytes((2, 2, width >> 8, width & 255))
        data += b"".join(run_lengths(channel) for channel in row.T)
    return data


def run_lengths(values):
    """The codes of a row of one channel: a run of 3 to 127 equal values is 128 + its length and the value."""
    data, at = b"", 0
    while at < len(values):
        same = 1
        while at + same < len(values) and same < 127 and values[at + same] == values[at]:
            same += 1
        if same < 3:
            data += bytes((1, values[at]))  # one value that stands for itself
            at += 1
        else:
            data += bytes((128 + same, values[at]))
            at += same
    return data


def exr_file(color=(), **channels):
    """The bytes of a picture (2, 3) of one linear color, if there is one."""
    with TemporaryDirectory() as folder:
        path = Path(folder, "x.exr")
        layers = ({"RGB": np.tile(np.float32(color), (2, 3, 1))} if len(color) else {}) | channels
        OpenEXR.File({"type": OpenEXR.scanlineimage}, layers).write(str(path))
        return path.read_bytes()


# ---- a full disk, as far as a program can tell ----


@contextmanager
def files_limited_to(size):
    """Files can't get larger than `size` bytes: writing more fails, as it does on a full disk. Windows has no such
    limit, so the test is skipped there."""
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
