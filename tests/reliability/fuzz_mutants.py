"""Random changes of files: of the structure of JSON, of bytes, of words and lines."""

from __future__ import annotations

import copy
import json
import random
from collections.abc import Callable
from typing import Any

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
    b"",
    b"0",
    b"-1",
    b"1",
    b"3",
    b"99",
    b"4294967295",
    b"1e999",
    b"nan",
    b"-inf",
    b"1e38",
    b"x",
    b"\xff\xfe",
    b"../x",
    b"/etc/passwd",
    b"mtllib",
    b"newmtl",
    b"map_Kd",
    b"usemtl",
    b"f",
    b"v",
    b"end_header",
    b"float",
    b"list",
    b"element",
    b"1//1",
    b"1/",
    b"a" * 3000,
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


def mutate_json(content: Any, generator: random.Random) -> bytes:
    """One to three changes of structure."""
    content = copy.deepcopy(content)
    for _ in range(generator.choice([1, 1, 1, 2, 3])):
        found = places(content)
        if not found:
            break
        change_structure(*generator.choice(found), found, generator)
    text = json.dumps(content)
    for token in ("NaN", "Infinity", "1e400", "-1e400"):
        text = text.replace(f'"{token}"', token)
    return text.encode()


def change_structure(container: Any, key: Any, found: list[Any], generator: random.Random) -> None:
    """Replace a value of a container, remove it, put another one's copy there, or repeat or count it."""
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


def mutate_text(data: bytes, generator: random.Random) -> bytes:
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
