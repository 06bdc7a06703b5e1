"""Loads mutated files and prints what went wrong; run by test_gltf_fuzz.py in a process with limits.

    PYTHONPATH=tests:tests/scene python tests/scene/fuzz_gltf.py KIND FOLDER COUNT SEED

Every mutant must load or raise SolariError, within five seconds, and open no file outside the folder; the last line
counts both.
"""

from __future__ import annotations

import contextlib
import copy
import json
import os
import random
import resource
import signal
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from fuzz_seeds import GLTF, MTL, mesh_file
from support.gltf_writer import GltfWriter, encoded, glb

import solari_vk as sv
from solari_vk.errors import SolariError

MEMORY_LIMIT = 3 * 2**30  # of address space, most of which the libraries only reserve
SECONDS = 5


VALUES: tuple[Callable[[random.Random], Any], ...] = (
    lambda r: r.choice([-1, 0, 1, 2, 3, 4, 5, 7, 100, 255, 65535, 5121, 5123, 5126]),
    lambda r: r.choice([2**31, 2**32, 2**53, 2**63, 10**30, 10**400, -(2**31), -(10**30)]),
    lambda r: r.choice([1e308, -1e308, 1e39, 1e-320, 0.5, -0.5, -0.0, 1e18, 3.0]),
    lambda r: r.choice(["NaN", "Infinity", "1e400", "-1e400"]),  # written without their quotes
    lambda r: r.choice(["", "x", "VEC3", "MAT4", "../x", "\ud800", "data:,", "a" * 300]),
    lambda r: r.choice([None, True, False]),
    lambda r: r.choice([[], {}, [[]], [{}], {"extensions": []}, [0] * 16, [0, 0, 0], [1e300] * 3]),
)


WORDS = (
    b"", b"0", b"-1", b"1", b"3", b"99", b"4294967295", b"1e999", b"nan", b"-inf", b"1e38", b"x", b"\xff\xfe", b"../x",
    b"/etc/passwd", b"mtllib", b"newmtl", b"map_Kd", b"usemtl", b"f", b"v", b"end_header", b"float", b"list",
    b"element", b"1//1", b"1/", b"a" * 3000,
)  # fmt: skip


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


def mesh_mutant(data: bytes, generator: random.Random) -> bytes:
    """A file of text or bytes with random changes of its bytes, its words or its lines."""
    if generator.random() < 0.5:
        return mutate_bytes(data, generator)
    lines = data.split(b"\n")
    for _ in range(generator.choice([1, 1, 2, 5])):
        at = generator.randrange(len(lines))
        words = lines[at].split(b" ")
        kind = generator.random()
        if kind < 0.6:
            words[generator.randrange(len(words))] = generator.choice(WORDS)
            lines[at] = b" ".join(words)
        elif kind < 0.8:
            lines.insert(generator.randrange(len(lines)), generator.choice(lines))
        else:
            del lines[at]
            lines = lines or [b""]
    return b"\n".join(lines)


def subjects(kind: str, folder: Path) -> tuple[Path, Callable[[random.Random], None]]:
    """The path of a kind of file, written as it should be, and a function that writes a mutant there."""
    if kind in GLTF:
        writer = GLTF[kind]()
        whole, path = writer.glb(), folder / "mutant.glb"
        path.write_bytes(whole)
        return path, lambda generator: path.write_bytes(mutant(writer, whole, generator)) and None
    data, path, materials = mesh_file(kind), folder / f"mutant.{kind.rpartition('.')[2]}", folder / "model.mtl"
    path.write_bytes(data)
    materials.write_bytes(MTL)
    picture = encoded(np.zeros((2, 2, 3)))
    (folder / "wood.png").write_bytes(picture)

    def write(generator: random.Random) -> None:
        which = generator.random() if kind == "obj" else 0.0
        path.write_bytes(mesh_mutant(data, generator) if which < 0.6 else data)
        materials.write_bytes(mesh_mutant(MTL, generator) if 0.5 < which < 0.9 else MTL)
        (folder / "wood.png").write_bytes(mutate_bytes(picture, generator) if which > 0.85 else picture)

    return path, write


def watch_files(folder: Path) -> list[str]:
    """The files outside a folder that are opened from now on, but for those of Python itself."""
    outside: list[str] = []
    allowed = tuple(map(str, (folder, sys.prefix, sys.base_prefix, Path(sv.__file__).parent, "/proc", "/sys")))

    def watch(event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open" and isinstance(arguments[0], (str, bytes, Path)):
            path = os.path.realpath(os.fsdecode(arguments[0]))
            if not path.startswith(allowed):
                outside.append(path)

    sys.addaudithook(watch)
    return outside


def play(scene: sv.Scene) -> None:
    """Pose the scene at some times of each clip, of which some may be refused."""
    for clip in range(len(scene.animations)):
        for seconds in (0.0, 0.3, 7.0):
            with contextlib.suppress(SolariError):
                scene.animate(seconds, clip, loop=False)


def main() -> None:
    kind, folder, count, seed = sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT, MEMORY_LIMIT))
    path, write = subjects(kind, folder)
    assert sv.load(path, strict=True).instances, "the file itself must be fine"
    counts = {"loaded": 0, "refused": 0, "failed": 0}
    outside = watch_files(folder)
    for number in range(seed, seed + count):
        write(random.Random(number))
        signal.alarm(SECONDS)
        try:
            scene = sv.load(path)
            play(scene)
            assert all(np.isfinite(instance.posed_mesh().positions).all() for instance in scene)
            str(scene.warnings).encode()
            assert not outside, f"read outside the folder: {outside}"
            counts["loaded"] += 1
        except SolariError as error:
            named = str(error).encode().startswith(str(path).encode())
            counts["refused" if named else "failed"] += 1
            assert not outside, f"read outside the folder: {outside}"
            if not named:
                print(f"seed {number}: the file isn't named: {error}", flush=True)
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
