"""Loads mutated glTF files and prints what went wrong; run by test_gltf_fuzz.py in a process with limits.

    PYTHONPATH=tests python tests/scene/fuzz_gltf.py FOLDER COUNT SEED

Every mutant must load or raise SolariError, within five seconds; the last line counts both.
"""

from __future__ import annotations

import copy
import json
import random
import resource
import signal
import struct
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from support.gltf_writer import TRIANGLE, GltfWriter, glb

from solari_vk.errors import SolariError
from solari_vk.scene.gltf import load_gltf

MEMORY_LIMIT = 3 * 2**30  # of address space, most of which the libraries only reserve
SECONDS = 5


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
        pbrMetallicRoughness={"baseColorFactor": [1, 1, 1, 0.5], "metallicFactor": 0.5, "roughnessFactor": 0.5,
                              "baseColorTexture": {"index": texture, "extensions": transform},
                              "metallicRoughnessTexture": {"index": photo, "texCoord": 1}},
        normalTexture={"index": photo, "scale": 0.5}, emissiveTexture={"index": texture}, emissiveFactor=[1, 1, 1],
        alphaMode="MASK", alphaCutoff=0.5, doubleSided=True,
        extensions={"KHR_materials_emissive_strength": {"emissiveStrength": 5}, "KHR_materials_ior": {"ior": 1.4},
                    "KHR_materials_specular": {"specularFactor": 0.5, "specularColorFactor": [1, 0.5, 0.5]},
                    "KHR_materials_clearcoat": {"clearcoatFactor": 1}, "KHR_materials_unlit": {}},
    )  # fmt: skip
    quad = [*TRIANGLE, [1, 1, 0]]
    uvs = [[0, 0], [1, 0], [0, 1], [1, 1]]
    full = writer.mesh(
        {"POSITION": quad, "NORMAL": [[0, 0, 1]] * 4, "TEXCOORD_0": uvs, "TEXCOORD_1": uvs,
         "COLOR_0": writer.accessor(np.full((4, 4), 200), "u1", normalized=True),
         "JOINTS_0": writer.accessor([[0, 1, 0, 0]] * 4, "u1"), "WEIGHTS_0": [[0.5, 0.5, 0, 0]] * 4},
        [0, 1, 2, 2, 1, 3], material=0, targets=[{"POSITION": writer.accessor(np.ones((4, 3)))}],
    )  # fmt: skip
    writer.json["meshes"][full]["weights"] = [0.5]
    strip = writer.mesh({"POSITION": writer.accessor([[*map(int, row)] for row in quad], "i2", stride=8)}, mode=5)
    writer.json["accessors"][-1]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": writer.view(b"\3\0"), "componentType": 5123},
        "values": {"bufferView": writer.view(struct.pack("<3h", 2, 2, 0))},
    }
    writer.mesh({"POSITION": quad, "TANGENT": [[1, 0, 0, 1]] * 4, "NORMAL": [[0, 0, 1]] * 4, "TEXCOORD_0": uvs}, mode=6,
                material=0)  # fmt: skip
    writer.mesh(mode=1)
    joints = [writer.node(translation=[1, 0, 0]), writer.node(rotation=[0, 0, 0, 1], scale=[1, 2, 1])]
    bind = writer.accessor(np.tile(np.eye(4).reshape(16), (2, 1)))
    writer.add("skins", joints=joints, inverseBindMatrices=bind)
    writer.json["extensions"] = {"KHR_lights_punctual": {"lights": [
        {"type": "directional", "intensity": 3, "color": [1, 1, 1]}, {"type": "spot", "spot": {}}]}}  # fmt: skip
    writer.add("cameras", type="perspective", perspective={"yfov": 1, "znear": 0.1})
    children = [
        writer.node(mesh=full, skin=0, name="skinned"),
        writer.node(mesh=full, matrix=[2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 1, 2, 3, 1]),
        writer.node(mesh=strip, extensions={"EXT_mesh_gpu_instancing": {
            "attributes": {"TRANSLATION": writer.accessor(np.ones((3, 3)))}}}),
        writer.node(mesh=2, extensions={"KHR_node_visibility": {"visible": False}}),
        writer.node(mesh=3, camera=0, extensions={"KHR_lights_punctual": {"light": 0}}),
        writer.node(extensions={"KHR_lights_punctual": {"light": 1}}),
    ]  # fmt: skip
    root = writer.node(children=children, rotation=[0, 0.6, 0, 0.8])
    moves = {"input": writer.accessor([[0.0], [1.0]]), "output": writer.accessor(np.ones((2, 3)))}
    writer.add("animations", channels=[{"sampler": 0, "target": {"node": root, "path": "scale"}}], samplers=[moves])
    writer.json["extensionsUsed"] = ["KHR_materials_ior", "KHR_lights_punctual"]
    writer.json["extensionsRequired"] = ["KHR_mesh_quantization"]
    writer.add("scenes", nodes=[root, *joints], name="main")
    writer.json["scene"] = 0
    writer.finish()
    return writer


VALUES: tuple[Callable[[random.Random], Any], ...] = (
    lambda r: r.choice([-1, 0, 1, 2, 3, 4, 5, 7, 100, 255, 65535, 5121, 5123, 5126]),
    lambda r: r.choice([2**31, 2**32, 2**53, 2**63, 10**30, 10**400, -(2**31), -(10**30)]),
    lambda r: r.choice([1e308, -1e308, 1e39, 1e-320, 0.5, -0.5, -0.0, 1e18, 3.0]),
    lambda r: r.choice(["NaN", "Infinity", "1e400", "-1e400"]),  # written without their quotes
    lambda r: r.choice(["", "x", "VEC3", "MAT4", "../x", "\ud800", "data:,", "a" * 300]),
    lambda r: r.choice([None, True, False]),
    lambda r: r.choice([[], {}, [[]], [{}], {"extensions": []}, [0] * 16, [0, 0, 0], [1e300] * 3]),
)


def places(value: Any) -> list[tuple[Any, Any]]:
    """Every (container, key) of the JSON."""
    found, waiting = [], [value]
    while waiting:
        container = waiting.pop()
        keys = container if isinstance(container, dict) else range(len(container))
        for key in keys:
            found.append((container, key))
            if isinstance(container[key], (dict, list)):
                waiting.append(container[key])
    return found


def mutate_json(content: dict[str, Any], generator: random.Random) -> bytes:
    """One to three changes of structure."""
    content = copy.deepcopy(content)
    for _ in range(generator.choice([1, 1, 1, 2, 3])):
        found = places(content)
        container, key = generator.choice(found)
        kind = generator.random()
        if kind < 0.6:
            container[key] = generator.choice(VALUES)(generator)
        elif kind < 0.75:
            del container[key]
        elif kind < 0.9:
            other, other_key = generator.choice(found)
            container[key] = copy.deepcopy(other[other_key])
        elif isinstance(container[key], list):
            container[key] = container[key] * generator.choice([2, 100])
        elif isinstance(container[key], (int, float)):
            container[key] = container[key] + generator.choice([-1, 1])
    text = json.dumps(content)
    for token in ("NaN", "Infinity", "1e400", "-1e400"):
        text = text.replace(f'"{token}"', token)
    return text.encode()


def mutate_bytes(data: bytes, generator: random.Random) -> bytes:
    """Flip bytes, cut the end, write wrong headers, or move blocks."""
    mutant = bytearray(data)
    kind = generator.random()
    if kind < 0.6:
        for _ in range(generator.choice([1, 2, 5, 20])):
            mutant[generator.randrange(len(mutant))] = generator.randrange(256)
    elif kind < 0.8:
        del mutant[generator.randrange(len(mutant)) :]
    elif kind < 0.9:
        offset = generator.choice([4, 8, 12, 16])
        mutant[offset : offset + 4] = generator.choice([b"\0" * 4, b"\xff" * 4, b"\0\0\0\x80", generator.randbytes(4)])
    else:
        start, end = sorted(generator.randrange(len(mutant)) for _ in range(2))
        del mutant[start:end]
    return bytes(mutant)


def mutant(writer: GltfWriter, whole: bytes, generator: random.Random) -> bytes:
    """A .glb file with random changes in its JSON, in its binary part, or anywhere."""
    kind = generator.random()
    if kind < 0.55:
        return glb(mutate_json(writer.json, generator), bytes(writer.data))
    if kind < 0.75:  # the binary part only, which the checks of the JSON don't cover
        return glb(json.dumps(writer.json).encode(), mutate_bytes(bytes(writer.data), generator))
    return mutate_bytes(whole, generator)


def main() -> None:
    folder, count, seed = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT, MEMORY_LIMIT))
    writer = everything()
    whole = writer.glb()
    path = folder / "mutant.glb"
    path.write_bytes(whole)
    assert len(load_gltf(path).instances) == 6, "the file itself must be fine"
    counts = {"loaded": 0, "refused": 0, "failed": 0}
    for number in range(seed, seed + count):
        content = mutant(writer, whole, random.Random(number))
        path.write_bytes(content)
        signal.alarm(SECONDS)
        try:
            scene = load_gltf(path)
            assert all(np.isfinite(instance.mesh.positions).all() for instance in scene)
            str(scene.warnings).encode()
            counts["loaded"] += 1
        except SolariError as error:
            named = str(error).encode().startswith(str(path).encode())
            counts["refused" if named else "failed"] += 1
        except BaseException:
            counts["failed"] += 1
            print(f"seed {number}:", traceback.format_exc(), flush=True)
        finally:
            signal.alarm(0)
    print(json.dumps({**counts, "peak_mib": _peak_mib()}))


def _peak_mib() -> int:
    """This process's peak memory; on Linux getrusage includes the parent's before exec."""
    status = Path("/proc/self/status")
    if status.exists():
        [line] = [line for line in status.read_text().splitlines() if line.startswith("VmHWM")]
        return int(line.split()[1]) // 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024


def _expired(*_: Any) -> None:
    raise TimeoutError(f"longer than {SECONDS} s")


if __name__ == "__main__":
    signal.signal(signal.SIGALRM, _expired)
    main()
