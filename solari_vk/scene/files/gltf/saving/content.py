"""The content of a glTF file that is written: its JSON, its buffer, and what glTF can't say of a scene."""

from __future__ import annotations

import itertools
import json
import os
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, warn
from solari_vk.base.files import followed, read_json, write_both, write_whole

LARGEST_GLB = 2**32 - 2**20  # bytes, which the file counts in 32 bits
# The codes of glTF 2.0, 3.6.2.2 (componentType) and 5.11 (target), which are OpenGL's.
_COMPONENTS = {"u1": 5121, "u2": 5123, "u4": 5125, "f4": 5126}
_KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
_VERTICES, _CORNERS = 34962, 34963
_PLACES_SHOWN = 3


class Content:
    """Objects and data, each written once. `lose` names what the file can't have."""

    def __init__(self) -> None:
        self.json: dict[str, Any] = {"asset": {"version": "2.0", "generator": "solari_vk"}}
        self._data: list[bytes] = []
        self._size = 0
        self._accessors: dict[Any, tuple[int, Any]] = {}
        self.written: dict[Any, tuple[str, dict[str, Any]]] = {}
        """By material, camera or light (luminaires: node): the pointer to what is written of it, and that itself."""
        self._lost: dict[str, dict[str, None]] = {}

    def add(self, kind: str, **fields: Any) -> int:
        """Append an object to a list ("nodes", "meshes", ...) and return its number. Empty fields are left out."""
        objects = self.json.setdefault(kind, [])
        objects.append({name: plain(value) for name, value in fields.items() if not _is_empty(value)})
        return len(objects) - 1

    def use(self, extension: str, data: Any = None, owner: dict[str, Any] | None = None) -> Any:
        """Name an extension among those that the file uses, and give an object, by default the file, its data, unless
        it has some; return what it then has."""
        used = self.json.setdefault("extensionsUsed", [])
        if extension not in used:
            used.append(extension)
        holder = (self.json if owner is None else owner).setdefault("extensions", {})
        return holder.setdefault(extension, {} if data is None else data)

    def lose(self, what: str, place: str) -> None:
        """Name what is lost of the object at a place."""
        self._lost.setdefault(what, {})[place] = None

    def view(self, data: bytes, target: int | None = None) -> int:
        """A buffer view of these bytes."""
        # glTF 2.0, 3.6.2.4: accessors begin at multiples of their components' sizes.
        padding = -self._size % 4
        self._data.append(b"\0" * padding + data)
        offset = self._size + padding
        self._size = offset + len(data)
        return self.add("bufferViews", buffer=0, byteOffset=offset, byteLength=len(data), target=target)

    def accessor(self, values: NDArray[Any], dtype: str = "f4", use: str = "data") -> int:
        """An accessor of rows (N, ...). use: "vertices", "positions" or "corners", which are written once for an array,
        "times" or "data", once for equal values. Positions and times get their bounds."""
        rows = np.ascontiguousarray(values, "<" + dtype).reshape(len(values), -1)
        data = rows.tobytes()
        # Times of channels are equal in most clips, arrays of vertices are shared by identity, which is cheaper to
        # find.
        key = data if use in ("times", "data") else id(values), rows.shape, dtype, use
        if key not in self._accessors:
            target = {"vertices": _VERTICES, "positions": _VERTICES, "corners": _CORNERS}.get(use)
            bounds = {"min": rows.min(axis=0), "max": rows.max(axis=0)} if use in ("positions", "times") else {}
            number = self.add(
                "accessors",
                bufferView=self.view(data, target),
                componentType=_COMPONENTS[dtype],
                count=len(rows),
                type=_KINDS[rows.shape[1]],
                **bounds,
            )
            self._accessors[key] = number, values  # which keeps its id
        return self._accessors[key][0]

    def write(self, path: Path) -> None:
        """Write a .glb, or a .gltf with its .bin, and warn of each kind of loss."""
        path = followed(path)
        binary = b"".join(self._data)
        buffer: dict[str, Any] = {"byteLength": len(binary)} if binary else {}
        if path.suffix.lower() == ".glb":
            text = _text(self.json | ({"buffers": [buffer]} if binary else {}))
            # The length of the file is a number of 32 bits.
            if len(text) + len(binary) > LARGEST_GLB:
                raise SolariError(f"{path}: a .glb file holds 4 GiB at most: save a .gltf file")
            write_whole(path, glb(text, binary))
        elif binary:
            data_path = data_path_of(path)
            buffer["uri"] = quote(data_path.name)
            # Both files or none: a .gltf without its .bin is lost.
            write_both((path, _text(self.json | {"buffers": [buffer]})), (data_path, binary))
        else:
            write_whole(path, _text(self.json))
        for what, places in self._lost.items():
            more = len(places) - _PLACES_SHOWN
            named = ", ".join(list(places)[:_PLACES_SHOWN]) + (f" and {more} more" if more > 0 else "")
            warn(f"{path}: {what}: {named}")


def data_path_of(path: Path) -> Path:
    """Where the buffer of a .gltf file is written: a file that isn't there yet, or that the file at `path` has as its
    buffer already. The user hasn't given this name, so that nothing else of this name is replaced."""
    known = {unquote(uri) for uri in _buffers_of(path)}
    numbered = (path.with_name(f"{path.stem}-{number}.bin") for number in itertools.count(2))
    candidates = itertools.chain([path.with_suffix(".bin")], numbered)
    return next(file for file in candidates if file.name in known or not os.path.lexists(file))


def _buffers_of(path: Path) -> list[str]:
    """What a .gltf file that is there names as its buffers."""
    try:
        return [str(buffer["uri"]) for buffer in read_json(path, str(path))["buffers"]]
    except (SolariError, TypeError, KeyError):
        return []


def glb(text: bytes, binary: bytes) -> bytes:
    """A .glb file of a JSON text and a buffer."""
    # glTF 2.0, 4.4.3: chunks end at multiples of four bytes, JSON by spaces and binary data by zeros.
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    if binary:
        chunks += struct.pack("<II", len(binary), 0x004E4942) + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def plain(value: Any) -> Any:
    """A value for JSON. Numbers with 32 bits become the shortest ones that are read back equal."""
    if isinstance(value, np.ndarray):
        return [plain(part) for part in value]
    if isinstance(value, np.float32):
        return float(str(value))
    return value.item() if isinstance(value, np.generic) else value


def _is_empty(value: Any) -> bool:
    return value is None or (isinstance(value, str | Mapping | list) and not value)


def _text(content: dict[str, Any]) -> bytes:
    return json.dumps(content, separators=(",", ":"), allow_nan=False).encode()
