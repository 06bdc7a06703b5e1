"""glTF files of a wavy sheet: plain, and compressed by meshopt and by Draco."""

import DracoPy
import meshopt
import numpy as np

from support.gltf_writer import COMPONENTS

SIDE = 12
MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
DRACO = "KHR_draco_mesh_compression"


def wave():
    """Positions, normals, uvs and triangles of the sheet."""
    u, v = np.indices((SIDE, SIDE)).reshape(2, -1) / (SIDE - 1)
    positions = np.stack([u, v, 0.1 * np.sin(6 * u)], 1)
    normals = np.stack([-0.6 * np.cos(6 * u), 0 * u, 1 + 0 * u], 1)
    corner = np.arange(SIDE * (SIDE - 1)).reshape(-1, SIDE)[:, :-1].ravel()
    triangles = np.r_[np.c_[corner, corner + SIDE, corner + 1], np.c_[corner + 1, corner + SIDE, corner + SIDE + 1]]
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
    positions, normals, uvs, triangles = wave()
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
    positions, normals, uvs, triangles = wave()
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
    positions, normals, uvs, triangles = wave()
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
