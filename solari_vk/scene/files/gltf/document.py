"""The content of a glTF file: its JSON and its buffers. Files outside its folder are never read."""

from __future__ import annotations

import base64
import binascii
import json
import os
import re
import struct
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.budget import BudgetError
from solari_vk.base.errors import SolariError
from solari_vk.base.files import charge_json, read_regular
from solari_vk.scene.files import libraries
from solari_vk.scene.files.gltf.values import Entry, WholeFileError, clean, shown

Bytes = NDArray[np.uint8]
LARGEST_JSON = 256 * 2**20
_LONGEST_NAME = 3 * 4096  # of a file, each byte in percent encoding
_PIECE = 2**16
# glTF 2.0, 4.4 (GLB): the ASCII letters "glTF", "JSON" and "BIN\0" as little-endian numbers.
_GLB_MAGIC = 0x46546C67
_JSON_CHUNK = 0x4E4F534A
_BIN_CHUNK = 0x004E4942
# EXT_meshopt_compression and its successor, which have the same fields, and the library that reads them.
_MESHOPT_EXTENSIONS = ("EXT_meshopt_compression", "KHR_meshopt_compression")
_MESHOPT = "meshopt"
_MESHOPT_FILTERS = ("NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL", "COLOR")


class Document:
    """The file's JSON as `Entry` objects and its binary data as byte arrays, each read on first use."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.file = clean(str(path))
        # Read at most what a valid file can have: a .glb declares its size, JSON has a limit.
        head = read_regular(self.path, self.file, 12)
        # The header of a .glb file: magic, version, and the length of all (glTF 2.0, 4.4.2).
        glb = head[:4] == _GLB_MAGIC.to_bytes(4, "little") and len(head) == 12
        max_bytes = max(struct.unpack_from("<I", head, 8)[0], 20) if glb else LARGEST_JSON + 1
        data = read_regular(self.path, self.file, max_bytes)
        self._binary: Bytes | None = None
        if len(data) >= 4 and struct.unpack_from("<I", data)[0] == _GLB_MAGIC:
            text, self._binary = self._split_glb(data)
        else:
            text = data
        self.root = Entry(self.file, "the file", self._parse(text))
        self._items: dict[tuple[str, int], Entry] = {}
        self._buffers: dict[int, Bytes] = {}
        self._unpacked: dict[int, Bytes] = {}
        self._decoded_bytes = 0
        self.buffer_bytes = 0
        self.version = self._checked_version()

    # ---- the JSON -----------------------------------------------------------------------------------

    def error(self, text: str) -> SolariError:
        """The exception for a fault of the whole file."""
        return SolariError(f"{self.file}: {text}")

    def _split_glb(self, data: bytes) -> tuple[bytes, Bytes | None]:
        if len(data) < 20:
            raise self.error("this .glb file ends inside its header; it is truncated: copy or download it again")
        version, length = struct.unpack_from("<II", data, 4)
        if version != 2:
            raise self.error(_other_version(version))
        if length > len(data):
            raise self.error(
                f"the .glb header says {length} bytes, but the file has {len(data)}; it is truncated: "
                "copy or download it again"
            )
        text: bytes | None = None
        binary: Bytes | None = None
        offset = 12
        # A chunk has its length, its type and its data. Readers skip unknown types (glTF 2.0, 4.4.3).
        while offset + 8 <= length:
            size, kind = struct.unpack_from("<II", data, offset)
            if size > length - offset - 8:
                raise self.error(
                    f"the .glb chunk at byte {offset} says {size} bytes, but {length - offset - 8} are left; "
                    "the file is truncated or damaged: copy or download it again"
                )
            if text is None:
                if kind != _JSON_CHUNK:
                    raise self.error("the first chunk of the .glb file is not JSON; it is damaged: export it again")
                text = data[offset + 8 : offset + 8 + size]
            # Of several binary chunks the first counts.
            elif kind == _BIN_CHUNK and binary is None:
                binary = np.frombuffer(data, np.uint8, size, offset + 8)
            offset += 8 + size
        if text is None:
            raise self.error("the .glb file has no JSON chunk; it is damaged: export it again")
        return text, binary

    def _parse(self, text: bytes) -> Any:
        if len(text) > LARGEST_JSON:
            raise self.error(
                f"the JSON has {len(text)} bytes, but at most {LARGEST_JSON} are read: put data in a .bin file"
            )
        charge_json(text, self.file)
        try:
            # A byte order mark is forbidden, but some programs write it. NaN and Infinity aren't JSON.
            return json.loads(text.decode("utf-8-sig"), parse_constant=_refuse_constant)
        except RecursionError:
            raise self.error("the JSON is nested too deeply to be a glTF file") from None
        except ValueError as error:
            raise self.error(
                f"neither a .glb file nor the JSON of a .gltf file ({shown(clean(str(error)))}); "
                "give a complete glTF 2.0 file"
            ) from None

    def _checked_version(self) -> str:
        """The version of the format. A later 2.x is read if the file doesn't say that 2.0 is too old for it."""
        asset = self.root.entry("asset")
        if asset is None:
            raise self.error("the JSON has no 'asset', so it is not a glTF 2.0 file")
        version = asset.text("version")
        least = asset.text("minVersion", "2.0")
        if version.split(".")[0] != "2":
            raise self.error(_other_version(version))
        if not re.fullmatch(r"[01](\.\d+)?|2(\.0+)?", least):
            raise self.error(f"the file needs glTF {shown(least)}; only 2.0 can be read: export it as glTF 2.0")
        return version

    def array(self, kind: str) -> list[Any]:
        """All objects of a kind ("node", "mesh", ...), as in the JSON."""
        return self.root.values("meshes" if kind == "mesh" else kind + "s", "objects")

    def item(self, kind: str, index: int, user: Entry) -> Entry:
        """The index-th object of a kind; `user` is the object that refers to it."""
        found = self._items.get((kind, index))
        if found is None:
            array = self.array(kind)
            if not 0 <= index < len(array):
                raise user.error(
                    f"refers to {kind} {shown(index)}, but the file has only {len(array)}; export the file again"
                )
            found = Entry(self.file, f"{kind} {index}", array[index])
            if found.name:
                found.place += f" {shown(found.name)}"
            self._items[kind, index] = found
        return found

    # ---- the binary data ----------------------------------------------------------------------------

    def charge(self, size: int, user: Entry, compressed: int = 0) -> None:
        """Add to the count of decoded bytes. Raises SolariError if a small file expands to a very large size.

        compressed: the size of the compressed data that these bytes come from. They count for four times as many.
        """
        self._decoded_bytes += size
        # Else a small compressed view would count for as much as it claims to hold.
        self.buffer_bytes += min(size, 4 * compressed)
        # Many accessors over the same bytes make a small file large: sixteen times the file's bytes are allowed.
        if self._decoded_bytes > 32 * 2**20 + 16 * self.buffer_bytes:
            raise WholeFileError(
                f"{user.file}: {user.place} makes the geometry {self._decoded_bytes >> 20} MiB large although the "
                f"file's buffers have only {self.buffer_bytes >> 20} MiB: its accessors overlap or have no data, so it "
                "is damaged or hostile"
            )
        user.charge(size, "its data")

    def view(self, index: int, user: Entry) -> tuple[Bytes, int | None]:
        """The bytes of a buffer view and its stride, None if its elements are packed.

        Raises WholeFileError for data that are missing or damaged.
        """
        try:
            return self._view(index, user)
        except BudgetError:
            raise
        except SolariError as error:
            raise WholeFileError(str(error)) from None

    def _view(self, index: int, user: Entry) -> tuple[Bytes, int | None]:
        view = self.item("bufferView", index, user)
        stride = view.integer("byteStride", low=4, high=252) if "byteStride" in view else None
        part = _meshopt_part(view)
        # EXT_meshopt_compression: without the library the fallback buffer is read, if the file has it.
        if part is None or (self._has_data(view) and not libraries.is_installed(_MESHOPT)):
            return self._range(view), stride
        data = self._unpacked.get(index)
        if data is None:
            packed = self._range(part)
            self.charge(_unpacked_size(part), part, len(packed))
            data = self._unpacked[index] = _unpack(part, packed)
        if len(data) < view.integer("byteLength", low=1):
            raise view.error(f"says more bytes than the {len(data)} of its compressed data; compress the file again")
        return data, stride

    def _range(self, part: Entry) -> Bytes:
        """The bytes of a buffer that an object refers to."""
        number = part.integer("buffer")
        buffer = self._buffers.get(number)
        if buffer is None:
            buffer = self._buffers[number] = self._load_buffer(number, part)
            self.buffer_bytes += len(buffer)
        offset = part.integer("byteOffset", 0)
        length = part.integer("byteLength", low=1)
        if offset + length > len(buffer):
            raise part.error(
                f"reaches from byte {offset} to {shown(offset + length)} of buffer {number}, which has only "
                f"{len(buffer)} bytes; the file is truncated or damaged: export it again"
            )
        return buffer[offset : offset + length]

    def _has_data(self, part: Entry) -> bool:
        """Whether there are bytes for what an object refers to, which the file need not have if it has others."""
        number = part.integer("buffer")
        return "uri" in self.item("buffer", number, part) or (number == 0 and self._binary is not None)

    def _load_buffer(self, index: int, user: Entry) -> Bytes:
        entry = self.item("buffer", index, user)
        length = entry.integer("byteLength", low=1)
        if "uri" in entry:
            data = self.resource(entry, length)
        elif index == 0 and self._binary is not None:
            data = self._binary
        else:
            raise entry.error("has no data: neither a 'uri' nor a .glb chunk holds it; export the file again")
        if len(data) < length:
            raise entry.error(
                f"says {length} bytes, but its data has {len(data)}: the file is truncated; copy or export it again"
            )
        return data[:length]

    def resource(self, entry: Entry, length: int | None = None) -> Bytes:
        """The bytes behind an object's 'uri': embedded data, or a file in the glTF's own folder.

        Of a file at most `length` bytes are read.
        """
        uri = entry.text("uri")
        if uri[:5].lower() == "data:":
            return _decode_data_uri(uri, entry)
        path = self.resource_path(entry)
        return np.frombuffer(read_regular(path, f"{self.file}: {entry.place}: {shown(uri)}", length), np.uint8)

    def resource_path(self, entry: Entry) -> Path:
        """The file that an object's 'uri' names, which must be inside the glTF's own folder."""
        uri = entry.text("uri")
        if len(uri) > _LONGEST_NAME:
            raise entry.error(f"has a 'uri' that no file can have: {shown(uri[:_LONGEST_NAME])}")
        folder = Path(os.path.realpath(self.path)).parent
        # Some exporters don't percent-encode names, so the name is tried as it is written, too.
        for name in dict.fromkeys((unquote(uri), uri)):
            if not _is_relative(name):
                raise self._outside(entry, uri)
            try:
                path = Path(os.path.realpath(folder / clean(name)))
                # After links are followed, so that none leads out of the folder. What is outside isn't even asked for.
                exists = path.is_relative_to(folder) and _exists(path)
            except (OSError, ValueError):
                raise entry.error(f"has a 'uri' that no file can have: {shown(uri)}") from None
            if not path.is_relative_to(folder) or path == folder:
                raise self._outside(entry, uri)
            if exists:
                return path
        raise entry.error(f"needs the file {shown(uri)}, which is not beside the glTF file: copy it there")

    @staticmethod
    def _outside(entry: Entry, uri: str) -> SolariError:
        return entry.error(
            f"has the 'uri' {shown(uri)}, which is not a relative path inside the glTF file's own folder; nothing else "
            "is read: copy the file there and name it by its relative path"
        )


def _is_relative(name: str) -> bool:
    """Whether the name of a file has no scheme such as http: or C:, no root, no home folder, and no backslash."""
    has_scheme = re.match(r"[A-Za-z][A-Za-z0-9+.-]*:", name) is not None
    return bool(name) and not has_scheme and name[0] not in ("/", "~") and "\\" not in name and "\0" not in name


def _other_version(version: Any) -> str:
    remedy = "convert it by gltf-pipeline (npx gltf-pipeline -i old.gltf -o new.glb)" if str(version)[:1] == "1" else ""
    return f"this is a glTF {shown(version)} file; only glTF 2.0 can be read: {remedy or 'export it as glTF 2.0'}"


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is not a JSON number")


def _exists(path: Path) -> bool:
    """Whether there is a file; OSError for a name that none can have (`Path.exists` of Python 3.14 raises nothing)."""
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    return True


def _decode_data_uri(uri: str, entry: Entry) -> NDArray[np.uint8]:
    """The bytes of a URI that contains its data."""
    entry.charge(0, "its data", working=2 * sys.getsizeof(uri))
    header, comma, body = uri.partition(",")
    try:
        if not comma:
            raise ValueError
        if header.lower().endswith(";base64"):
            # Base64 has no percent signs, but some programs encode its + and /.
            entry.charge(3 * len(body) // 4, "its data", working=3 * sys.getsizeof(body))
            text = b"".join(_unquoted(body))
            # Padding is often missing.
            return np.frombuffer(base64.b64decode(text + b"=" * (-len(text) % 4), validate=True), np.uint8)
        found = bytearray()
        for piece in _unquoted(body):
            spare = len(found) // 8  # of a bytearray that grows
            entry.charge(len(piece), "its data", working=spare + sys.getsizeof(body))
            found += piece
        return np.frombuffer(found, np.uint8)
    except (ValueError, binascii.Error):
        raise entry.error("has a data URI that is not valid base64; export the file again") from None


def _unquoted(text: str) -> Iterator[bytes]:
    """The bytes of a text with percent signs, in pieces, because the part behind each sign is an object for a while."""
    start = 0
    while start < len(text):
        end = start + _PIECE
        # A piece doesn't end within the three characters of a byte.
        sign = text.rfind("%", end - 2, end)
        end = end if sign < 0 else sign
        yield unquote_to_bytes(text[start:end])
        start = end


def _meshopt_part(entry: Entry) -> Entry | None:
    """The extension of a buffer view, if it is compressed."""
    for name in _MESHOPT_EXTENSIONS:
        part = entry.extension(name)
        if part is not None:
            return part
    return None


def _unpacked_size(part: Entry) -> int:
    """The size of a view without compression, in bytes. part: of `_meshopt_part`."""
    return part.integer("count") * part.integer("byteStride", low=1, high=256)


def _unpack(part: Entry, data: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The bytes of a view without compression."""
    count = part.integer("count")
    stride = part.integer("byteStride", low=1, high=256)
    mode = part.text("mode", None, ("ATTRIBUTES", "TRIANGLES", "INDICES"))
    kind = part.text("filter", "NONE", _MESHOPT_FILTERS)
    library = libraries.library(_MESHOPT, f"{part.file}: {part.place}")
    try:
        # Filters are for attributes only.
        rows = library.decode_gltf_buffer(data, count, stride, mode, kind if mode == "ATTRIBUTES" else None)
    except ValueError as error:
        raise part.error(f"has damaged data ({error}); compress the file again") from None
    found: NDArray[np.uint8] = np.ascontiguousarray(rows).view(np.uint8).reshape(-1)
    return found
