"""Compressed files: one vase as plain glTF, quantized, by meshopt and by Draco.

From the left: 32-bit floats, `KHR_mesh_quantization` with 16 and 8 bits, `EXT_meshopt_compression`, and
`KHR_draco_mesh_compression` with 12 bits. The pattern is a WebP texture (`EXT_texture_webp`).
"""

from __future__ import annotations

import io
import json
import struct
import tempfile
from pathlib import Path
from typing import Any

import DracoPy
import meshopt
import numpy as np
from PIL import Image

import solari_vk as sv

KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
COMPONENTS = {"i1": 5120, "i2": 5122, "u2": 5123, "f4": 5126}
AROUND, RINGS = 96, 80


class File:
    """A .glb file of one mesh with a textured material."""

    def __init__(self, *extensions: str) -> None:
        self.data = bytearray()
        self.json: dict[str, Any] = {
            "asset": {"version": "2.0"},
            "bufferViews": [],
            "accessors": [],
            "scenes": [{"nodes": [0]}],
            "scene": 0,
            **{key: [*extensions, "EXT_texture_webp"] for key in ("extensionsUsed", "extensionsRequired")},
        }

    def view(self, data: bytes, **fields: Any) -> int:
        """A part of the buffer."""
        self.data += bytes(-len(self.data) % 4)
        self.json["bufferViews"].append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data), **fields})
        self.data += data
        return len(self.json["bufferViews"]) - 1

    def accessor(self, rows: Any, dtype: str, view: int | None = None, **fields: Any) -> int:
        """Rows of numbers, in a part of their own or in a given one."""
        rows = np.asarray(rows, "<" + dtype)
        fields |= {} if view is None else {"bufferView": view}
        fields |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()} if rows.ndim == 2 else {}
        width = 1 if rows.ndim == 1 else rows.shape[1]
        self.json["accessors"].append(
            {"componentType": COMPONENTS[dtype], "count": len(rows), "type": KINDS[width], **fields}
        )
        return len(self.json["accessors"]) - 1

    def plain(self, rows: Any, dtype: str, **fields: Any) -> int:
        """An accessor of rows that are written as they are, each at a multiple of four bytes."""
        rows = np.asarray(rows, "<" + dtype)
        if rows.ndim == 1:
            return self.accessor(rows, dtype, self.view(rows.tobytes()), **fields)
        size = rows[0].nbytes
        padded = np.zeros((len(rows), -(-size // 4) * 4), np.uint8)
        padded[:, :size] = np.ascontiguousarray(rows).view(np.uint8).reshape(len(rows), -1)
        return self.accessor(rows, dtype, self.view(padded.tobytes(), byteStride=padded.shape[1]), **fields)

    def load(self, attributes: dict[str, int], indices: int, texture: bytes, **primitive: Any) -> sv.Scene:
        """The scene of the file."""
        image = {"bufferView": self.view(texture), "mimeType": "image/webp"}
        paint = {"baseColorTexture": {"index": 0}, "metallicFactor": 0, "roughnessFactor": 0.35}
        material = {"doubleSided": True, "pbrMetallicRoughness": paint}
        mesh = {"primitives": [{"attributes": attributes, "indices": indices, "material": 0, **primitive}]}
        self.json |= {
            "images": [image],
            "textures": [{"extensions": {"EXT_texture_webp": {"source": 0}}}],
            "materials": [material],
            "meshes": [mesh],
            "nodes": [{"mesh": 0}],
        }
        self.json.setdefault("buffers", []).insert(0, {"byteLength": len(self.data)})
        text = json.dumps(self.json).encode()
        text += b" " * (-len(text) % 4)
        self.data += bytes(-len(self.data) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        chunks += struct.pack("<I4s", len(self.data), b"BIN\0") + self.data
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "vase.glb"
            path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
            return sv.load_gltf(path, strict=True)


Vase = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def vase() -> Vase:
    """Positions, normals, uvs and triangles of a surface of revolution, 1 m high."""
    v, u = np.repeat(np.linspace(0, 1, RINGS), AROUND), np.tile(np.linspace(0, 1, AROUND), RINGS)
    radius = 0.19 + 0.11 * np.sin(5.2 * v + 0.3) * (1 - 0.4 * v)
    slope = 0.11 * (5.2 * np.cos(5.2 * v + 0.3) * (1 - 0.4 * v) - 0.4 * np.sin(5.2 * v + 0.3))
    x, z = np.cos(2 * np.pi * u), -np.sin(2 * np.pi * u)
    normals = np.stack([x, -slope, z], 1) / np.sqrt(1 + slope[:, None] ** 2)
    first = (np.arange(RINGS - 1)[:, None] * AROUND + np.arange(AROUND - 1)).reshape(-1)
    triangles = np.r_[np.c_[first, first + 1, first + AROUND], np.c_[first + 1, first + AROUND + 1, first + AROUND]]
    return np.stack([radius * x, v, radius * z], 1), normals, np.stack([u, 1 - v], 1), triangles


def pattern() -> bytes:
    """A WebP image of bands and lozenges."""
    y, x = np.indices((256, 256)) / 256
    lozenges = (np.abs((12 * x) % 1 - 0.5) + np.abs((6 * y) % 1 - 0.5)) < 0.35
    band = (np.abs(y - 0.5) > 0.42)[..., None]
    colors = np.where(lozenges[..., None], (0.75, 0.3, 0.12), (0.9, 0.85, 0.75))
    pixels = (255 * np.where(band, (0.1, 0.2, 0.35), colors)).astype(np.uint8)
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "WEBP", quality=90)
    return file.getvalue()


def plain_file(mesh: Vase, texture: bytes) -> sv.Scene:
    """32-bit floats."""
    positions, normals, uvs, triangles = mesh
    file = File()
    attributes = {
        "POSITION": file.plain(positions, "f4"),
        "NORMAL": file.plain(normals, "f4"),
        "TEXCOORD_0": file.plain(uvs, "f4"),
    }
    return file.load(attributes, file.plain(triangles.reshape(-1), "u2"), texture)


def quantized_file(mesh: Vase, texture: bytes) -> sv.Scene:
    """16 bits for positions and uvs, 8 for normals."""
    positions, normals, uvs, triangles = mesh
    file = File("KHR_mesh_quantization")
    attributes = {
        "POSITION": file.plain(np.rint(positions * 32767), "i2", normalized=True),
        "NORMAL": file.plain(np.rint(normals * 127), "i1", normalized=True),
        "TEXCOORD_0": file.plain(np.rint(uvs * 65535), "u2", normalized=True),
    }
    return file.load(attributes, file.plain(triangles.reshape(-1), "u2"), texture)


def meshopt_file(mesh: Vase, texture: bytes) -> sv.Scene:
    """Quantized as above, then compressed."""
    positions, normals, uvs, triangles = mesh
    file = File("KHR_mesh_quantization", "EXT_meshopt_compression")
    held = 0

    def packed(rows: Any, dtype: str, mode: str = "ATTRIBUTES", **fields: Any) -> int:
        nonlocal held
        rows = np.ascontiguousarray(np.asarray(rows, "<" + dtype))
        stride = rows.nbytes // len(rows)
        stored = file.json["bufferViews"].pop(file.view(meshopt.encode_gltf_buffer(rows, mode, 0)))
        part = {**stored, "byteStride": stride, "count": len(rows), "mode": mode}
        outer = {"buffer": 1, "byteOffset": held, "byteLength": rows.nbytes}
        outer |= {"byteStride": stride} if mode == "ATTRIBUTES" else {}
        file.json["bufferViews"].append({**outer, "extensions": {"EXT_meshopt_compression": part}})
        held += -(-rows.nbytes // 4) * 4
        view = len(file.json["bufferViews"]) - 1
        return file.accessor(rows[:, :3] if rows.ndim == 2 else rows, dtype, view, **fields)

    none = np.zeros(len(positions))
    attributes = {
        "POSITION": packed(np.c_[np.rint(positions * 32767), none], "i2", normalized=True),
        "NORMAL": packed(np.c_[np.rint(normals * 127), none], "i1", normalized=True),
        "TEXCOORD_0": packed(np.rint(uvs * 65535), "u2", normalized=True),
    }
    indices = packed(triangles.reshape(-1), "u2", "TRIANGLES")
    file.json["buffers"] = [{"byteLength": held, "extensions": {"EXT_meshopt_compression": {"fallback": True}}}]
    return file.load(attributes, indices, texture)


def draco_file(mesh: Vase, texture: bytes) -> sv.Scene:
    """12 bits a coordinate."""
    positions, normals, uvs, triangles = mesh
    file = File("KHR_draco_mesh_compression")
    data = DracoPy.encode(positions, triangles.astype(np.uint32), quantization_bits=12, normals=normals, tex_coord=uvs)
    numbers = {item["attribute_type"]: item["unique_id"] for item in DracoPy.decode(data).attributes}
    kinds = {
        "POSITION": DracoPy.AttributeType.POSITION,
        "NORMAL": DracoPy.AttributeType.NORMAL,
        "TEXCOORD_0": DracoPy.AttributeType.TEX_COORD,
    }
    arrays = dict(zip(kinds, (positions, normals, uvs), strict=True))
    attributes = {name: file.accessor(values, "f4") for name, values in arrays.items()}
    extension = {"bufferView": file.view(data), "attributes": {name: numbers[kind] for name, kind in kinds.items()}}
    indices = file.accessor(triangles.reshape(-1), "u2")
    return file.load(attributes, indices, texture, extensions={"KHR_draco_mesh_compression": extension})


def scene(assets: Path | None) -> sv.Scene:
    """Four vases in a row in the studio."""
    made = sv.Scene()
    mesh, texture = vase(), pattern()
    for number, load in enumerate((plain_file, quantized_file, meshopt_file, draco_file)):
        (instance,) = load(mesh, texture)
        made.add(instance.mesh, instance.material, [0.62 * (number - 1.5), 0, 0], name=load.__name__)
    made.camera = sv.Camera.framing(made.bounds, (-0.1, -0.2, -1.0), aspect=16 / 9)
    return sv.studio_lights(made, camera=made.camera)
