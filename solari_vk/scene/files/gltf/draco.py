"""KHR_draco_mesh_compression: primitives that the library Draco has compressed."""

from __future__ import annotations

from typing import Any

import numpy as np

from solari_vk.base.errors import SolariError
from solari_vk.scene.files import libraries
from solari_vk.scene.files.gltf.accessors import Accessors
from solari_vk.scene.files.gltf.document import Bytes, Document
from solari_vk.scene.files.gltf.values import Entry, WholeFileError

EXTENSION = "KHR_draco_mesh_compression"
_BYTES_PER_FACE = 24  # of indices and tables, at least, while Draco works
_HAS_METADATA = 0x8000


class DracoMeshes:
    """Gives the accessors of compressed primitives their data."""

    def __init__(self, document: Document, accessors: Accessors) -> None:
        self._document = document
        self._accessors = accessors
        self._meshes: dict[int, Any] = {}

    def unpack(self, primitive: Entry, attributes: Entry) -> int | None:
        """Decompress a primitive, and return the number of its buffer view; None if it wasn't compressed.

        Without the library its accessors' own data are used, if they have any.
        """
        packed = primitive.extension(EXTENSION)
        position = attributes.index("POSITION")
        if packed is None or position is None:
            return None
        if self._accessors.has_data(position, attributes) and not libraries.is_installed("DracoPy"):
            return None
        ids = packed.entry("attributes")
        indices = primitive.index("indices")
        if ids is None or indices is None:
            raise primitive.error(f"needs 'indices', and 'attributes' in {EXTENSION}; compress the file again")
        mesh = self._mesh(packed)
        arrays = {attribute["unique_id"]: attribute["data"] for attribute in mesh.attributes}
        for name in ids.data:
            accessor = attributes.index(name)
            number = ids.integer(name)
            if number not in arrays:
                raise ids.error(f"names the attribute {number} for {name}, which the data doesn't have")
            if accessor is not None:
                # The accessor says type and range, the data replace its view.
                self._accessors.provide(accessor, arrays[number], attributes)
        self._accessors.provide(indices, mesh.faces.reshape(-1, 1), primitive)
        return packed.integer("bufferView")

    def _mesh(self, packed: Entry) -> Any:
        """The decompressed mesh of a buffer view."""
        number = packed.integer("bufferView")
        if number not in self._meshes:
            # The library allocates for as many faces as the data claim, so that they are charged before.
            data, _ = self._document.view(number, packed)
            try:
                faces = _face_count(data)
            except (IndexError, ValueError):
                raise packed.error("has no Draco mesh of version 2.2; compress the file again") from None
            self._document.charge(faces * _BYTES_PER_FACE, packed, len(data))
            try:
                draco = libraries.library("DracoPy", f"{packed.file}: {packed.place}")
            except SolariError as error:
                raise WholeFileError(str(error)) from None
            try:
                mesh = draco.decode(data.tobytes())
            except (draco.FileTypeException, ValueError) as error:
                raise packed.error(f"has damaged data ({error}); compress the file again") from None
            # What it really has may be more than what was charged for faces.
            for attribute in mesh.attributes:
                self._document.charge(np.asarray(attribute["data"]).nbytes, packed)
            self._meshes[number] = mesh
        return self._meshes[number]


def _face_count(data: Bytes) -> int:
    """The number of triangles that a mesh claims to have. IndexError or ValueError for data of another kind.

    Draco allocates memory for them before it reads them.
    """
    major, minor, kind, method = data[5:9].tolist()
    # The bitstream begins with the name, the version, the kind of geometry (1: a mesh), the method and the flags.
    if data[:5].tobytes() != b"DRACO" or (major, minor) != (2, 2) or kind != 1:
        raise ValueError
    reader = _Reader(data, 11)
    if int(data[9]) + 256 * int(data[10]) & _HAS_METADATA:
        for _ in range(reader.number()):
            reader.number()
            reader.skip_metadata()
        reader.skip_metadata()
    if method == 1:  # of edgebreaker: the kind of traversal and the number of vertices come first
        reader.skip(1)
        reader.number()
    return reader.number()


class _Reader:
    """Reads the header of Draco data."""

    def __init__(self, data: Bytes, offset: int) -> None:
        self._data = data
        self._offset = offset

    def skip(self, size: int) -> None:
        self._offset += size

    def byte(self) -> int:
        self._offset += 1
        return int(self._data[self._offset - 1])

    def number(self) -> int:
        """An integer in groups of seven bits, the lowest first."""
        result = 0
        for shift in range(0, 64, 7):
            byte = self.byte()
            # LEB128: the highest bit says that more follow.
            result |= (byte & 0x7F) << shift
            if byte < 0x80:
                return result
        raise ValueError

    def skip_metadata(self) -> None:
        """Skip names with values, and parts, each of which has a name and then metadata of its own."""
        parts = self._skip_values()
        while parts:
            self.skip(self.byte())
            parts += self._skip_values() - 1

    def _skip_values(self) -> int:
        """Skip the values of one part, and say how many parts it has."""
        for _ in range(self.number()):
            self.skip(self.byte())
            self.skip(self.number())
        return self.number()
