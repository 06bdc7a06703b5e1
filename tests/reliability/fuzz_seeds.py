"""The files that are mutated: small, and between them with every part of the loaders."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import OpenEXR
import trimesh
from PIL import Image
from support.files import (
    KTX2_ETC1S,
    KTX2_UASTC,
    KTX2_UASTC_ZSTD,
    TRIANGLE,
    GltfWriter,
    draco_file,
    hdr_file,
    image_file,
    ktx2_file,
    meshopt_file,
)


def everything() -> GltfWriter:
    """A small file that uses every part of the loader."""
    writer = GltfWriter()
    pixels = np.random.default_rng(3).integers(0, 255, (8, 8, 4))
    texture, photo = writer.image(pixels), writer.image(pixels[..., :3], "JPEG")
    writer.json["textures"][texture]["sampler"] = writer.add("samplers", wrapS=33071, magFilter=9728, minFilter=9985)
    transform = {"KHR_texture_transform": {"offset": [0.5, 0.5], "rotation": 1.0, "scale": [2, 2], "texCoord": 0}}
    writer.add(
        "materials",
        name="all",
        pbrMetallicRoughness={
            "baseColorFactor": [1, 1, 1, 0.5],
            "metallicFactor": 0.5,
            "roughnessFactor": 0.5,
            "baseColorTexture": {"index": texture, "extensions": transform},
            "metallicRoughnessTexture": {"index": photo, "texCoord": 1},
        },
        normalTexture={"index": photo, "scale": 0.5},
        emissiveTexture={"index": texture},
        emissiveFactor=[1, 1, 1],
        alphaMode="MASK",
        alphaCutoff=0.5,
        doubleSided=True,
        extensions={
            "KHR_materials_emissive_strength": {"emissiveStrength": 5},
            "KHR_materials_ior": {"ior": 1.4},
            "KHR_materials_specular": {"specularFactor": 0.5, "specularColorFactor": [1, 0.5, 0.5]},
            "KHR_materials_clearcoat": {"clearcoatFactor": 1, "clearcoatRoughnessFactor": 0.2},
            "KHR_materials_transmission": {"transmissionFactor": 0.5},
            "KHR_materials_volume": {"thicknessFactor": 1, "attenuationColor": [1, 0.5, 0]},
            "KHR_materials_sheen": {"sheenColorFactor": [1, 0, 1]},
            "KHR_materials_anisotropy": {"anisotropyStrength": 0.5},
            "KHR_materials_unlit": {},
        },
    )
    quad = [*TRIANGLE, [1, 1, 0]]
    uvs = [[0, 0], [1, 0], [0, 1], [1, 1]]
    full = writer.mesh(
        {
            "POSITION": quad,
            "NORMAL": [[0, 0, 1]] * 4,
            "TEXCOORD_0": uvs,
            "TEXCOORD_1": uvs,
            "COLOR_0": writer.accessor(np.full((4, 4), 200), "u1", normalized=True),
            "JOINTS_0": writer.accessor([[0, 1, 0, 0]] * 4, "u1"),
            "WEIGHTS_0": [[0.5, 0.5, 0, 0]] * 4,
        },
        [0, 1, 2, 2, 1, 3],
        material=0,
        targets=[{"POSITION": writer.accessor(np.ones((4, 3)))}],
    )
    writer.json["meshes"][full]["weights"] = [0.5]
    strip = writer.mesh({"POSITION": writer.accessor([[*map(int, row)] for row in quad], "i2", stride=8)}, mode=5)
    writer.json["accessors"][-1]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": writer.view(b"\3\0"), "componentType": 5123},
        "values": {"bufferView": writer.view(struct.pack("<3h", 2, 2, 0))},
    }
    writer.mesh(
        {"POSITION": quad, "TANGENT": [[1, 0, 0, 1]] * 4, "NORMAL": [[0, 0, 1]] * 4, "TEXCOORD_0": uvs},
        mode=6,
        material=0,
    )
    writer.mesh(mode=1)
    joints = [writer.node(translation=[1, 0, 0]), writer.node(rotation=[0, 0, 0, 1], scale=[1, 2, 1])]
    bind = writer.accessor(np.tile(np.eye(4).reshape(16), (2, 1)))
    writer.add("skins", joints=joints, inverseBindMatrices=bind)
    writer.json["extensions"] = {
        "KHR_lights_punctual": {
            "lights": [{"type": "directional", "intensity": 3, "color": [1, 1, 1]}, {"type": "spot", "spot": {}}]
        }
    }
    writer.add("cameras", type="perspective", perspective={"yfov": 1, "znear": 0.1})
    children = [
        writer.node(mesh=full, skin=0, name="skinned"),
        writer.node(mesh=full, matrix=[2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 1, 2, 3, 1]),
        writer.node(
            mesh=strip,
            extensions={"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": writer.accessor(np.ones((3, 3)))}}},
        ),
        writer.node(mesh=2, extensions={"KHR_node_visibility": {"visible": False}}),
        writer.node(mesh=3, camera=0, extensions={"KHR_lights_punctual": {"light": 0}}),
        writer.node(extensions={"KHR_lights_punctual": {"light": 1}}),
    ]
    root = writer.node(children=children, rotation=[0, 0.6, 0, 0.8])
    times = writer.accessor([[0.0], [1.0]])
    keys = [
        (root, "scale", np.ones((2, 3))),
        (joints[0], "rotation", [[0, 0, 0, 1], [0, 0, 1, 0]]),
        (joints[1], "translation", np.ones((6, 3))),
        (children[0], "weights", [[0], [1]]),
    ]
    samplers = [{"input": times, "output": writer.accessor(values)} for _, _, values in keys]
    samplers[2]["interpolation"] = "CUBICSPLINE"
    channels = [{"sampler": n, "target": {"node": node, "path": path}} for n, (node, path, _) in enumerate(keys)]
    writer.add("animations", channels=channels, samplers=samplers)
    gradient = {name: [1, 0.5, 0] for name in ("topColor", "horizonColor", "bottomColor")}
    writer.json["extensions"]["OMI_environment_sky"] = {
        "skies": [
            {"type": "panorama", "panorama": {"equirectangular": texture, "cubemap": [texture] * 6}},
            {"type": "gradient", "gradient": gradient},
        ]
    }
    writer.json["extensionsUsed"] = ["KHR_materials_ior", "KHR_lights_punctual"]
    writer.json["extensionsRequired"] = ["KHR_mesh_quantization"]
    writer.add("scenes", nodes=[root, *joints], name="main")
    writer.json["scene"] = 0
    writer.finish()
    return writer


def compressed_images() -> GltfWriter:
    """Images in all formats, and variants of a material."""
    writer = GltfWriter()
    noise = np.random.default_rng(3).integers(0, 255, (8, 8, 4))
    files = [
        KTX2_ETC1S,
        KTX2_UASTC,
        KTX2_UASTC_ZSTD,
        ktx2_file(noise, 37, 2),
        ktx2_file(noise, 37, 3),
        image_file(noise, "WEBP"),
        image_file(noise, "WEBP", lossless=True),
    ]
    for number, file in enumerate(files):
        image = {"source": writer.add("images", bufferView=writer.view(file))}
        name = "KHR_texture_basisu" if number < 5 else "EXT_texture_webp"
        texture = writer.add("textures", extensions={name: image}, source=0)
        writer.add("materials", emissiveTexture={"index": texture}, name=str(number))
    mappings = [{"material": number, "variants": [number % 2]} for number in range(len(files))]
    variants = "KHR_materials_variants"
    writer.json["extensions"] = {variants: {"variants": [{"name": "a"}, {"name": "b"}]}}
    uvs = [[0, 0], [1, 0], [0, 1]]
    writer.mesh({"TEXCOORD_0": uvs}, material=0, extensions={variants: {"mappings": mappings}})
    writer.finish()
    return writer


def _made(make: Callable[[GltfWriter], object]) -> GltfWriter:
    writer = GltfWriter()
    make(writer)
    writer.finish()
    return writer


GLTF: dict[str, Callable[[], GltfWriter]] = {
    "gltf": everything,
    "images": compressed_images,
    "meshopt": lambda: _made(meshopt_file),
    "draco": lambda: _made(draco_file),
}

MTL = b"""newmtl red
Kd 0.8 0.1 0.1
Ns 98
Ke 1 1 1
Ni 1.4
d 0.5
map_Kd wood.png
newmtl blue
Pr 0.5
Pm 1
norm wood.png
"""


def mesh_file(kind: str) -> bytes:
    """A file of a kind of MESHES."""
    ball = trimesh.creation.icosphere(subdivisions=1)
    if kind == "obj":
        text = trimesh.exchange.obj.export_obj(ball, include_normals=True, include_color=True).split("\n")
        middle = len(text) - 40
        uvs = ["vt 0 0", "vt 1 0", "vt 0 1"]
        lines = [
            "mtllib model.mtl",
            *text[:middle],
            "usemtl red",
            *text[middle:],
            *uvs,
            "usemtl blue",
            "f 1/1 2/2 3/3",
            "f -1/1 -2/2 -3/3 -4/1",
            "f 1/1/1 2/2/2 3/3/3",
        ]
        return "\n".join(lines).encode()
    ball.visual.vertex_colors = np.tile([200, 100, 50, 255], (len(ball.vertices), 1))
    encodings = {"ascii.ply": "ascii", "binary.ply": "binary"}
    if kind in encodings:
        return bytes(trimesh.exchange.ply.export_ply(ball, encoding=encodings[kind], vertex_normal=True))
    data = ball.export(file_type="stl_ascii" if kind == "ascii.stl" else "stl")
    return data.encode() if isinstance(data, str) else bytes(data)


MESHES = ("obj", "ascii.ply", "binary.ply", "ascii.stl", "binary.stl")


def _ktx2() -> list[tuple[bytes, str]]:
    noise = np.random.default_rng(3).integers(0, 255, (8, 8, 4))
    files = [KTX2_ETC1S, KTX2_UASTC, KTX2_UASTC_ZSTD]
    files += [ktx2_file(noise, 37, scheme) for scheme in (0, 2, 3)]
    return [(file, "KHR_texture_basisu") for file in files]


def _exr_textures() -> list[tuple[bytes, str]]:
    with TemporaryDirectory() as folder:
        return [(file, "EXT_texture_exr") for file in _exr(Path(folder))]


def _dds() -> list[tuple[bytes, str]]:
    noise = Image.fromarray(np.random.default_rng(3).integers(0, 255, (8, 8, 3), np.uint8))
    files = [
        image_file(noise, "DDS"),
        *(image_file(noise, "DDS", pixel_format=name) for name in ("DXT1", "DXT5", "BC5")),
    ]
    return [(file, "MSFT_texture_dds") for file in files]


def _png() -> list[tuple[bytes, str]]:
    """One has something after its end, which readers skip: nearly all other damage breaks a checksum."""
    whole = image_file(np.random.default_rng(3).integers(0, 255, (8, 8, 3)))
    return [(whole, ""), (whole + bytes(200), "")]


def _pictures(kind: str, extension: str, *options: dict[str, object]) -> Callable[[], list[tuple[bytes, str]]]:
    noise = np.random.default_rng(3).integers(0, 255, (8, 8, 3))
    return lambda: [(image_file(noise, kind, **more), extension) for more in options or ({},)]


IMAGES: dict[str, Callable[[], list[tuple[bytes, str]]]] = {
    "ktx2": _ktx2,
    "webp": _pictures("WEBP", "EXT_texture_webp", {}, {"lossless": True}),
    "exr_textures": _exr_textures,
    "dds": _dds,
    "png": _png,
    "jpeg": _pictures("JPEG", "", {}, {"progressive": True}),
}
"""Files of images, each with the extension of glTF that names them."""


def _hdr(folder: Path) -> list[bytes]:
    codes = np.random.default_rng(3).integers(100, 140, (8, 16, 4)).astype(np.uint8)
    return [hdr_file(codes), hdr_file(codes, runs=False)]


def _exr(folder: Path) -> list[bytes]:
    colors = np.random.default_rng(3).random((8, 16, 3)).astype(np.float32)
    path = folder / "seed.exr"
    files = []
    for compression in (OpenEXR.ZIP_COMPRESSION, OpenEXR.PIZ_COMPRESSION, OpenEXR.NO_COMPRESSION):
        for kind in (OpenEXR.scanlineimage, OpenEXR.tiledimage):
            header = {"compression": compression, "type": kind}
            if kind == OpenEXR.tiledimage:
                header["tiles"] = OpenEXR.TileDescription()
            OpenEXR.File(header, {"RGB": colors}).write(str(path))
            files.append(path.read_bytes())
    path.unlink()
    return files


RADIANCE: dict[str, Callable[[Path], list[bytes]]] = {"hdr": _hdr, "exr": _exr}
"""Environments; the functions may write into a folder."""

OTHERS = ("external", "camera", "path", "transforms", "journal")
