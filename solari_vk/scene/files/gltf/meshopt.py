"""EXT_meshopt_compression and KHR_meshopt_compression: buffer views that the library meshoptimizer has compressed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene.files import libraries
from solari_vk.scene.files.gltf.values import Entry

EXTENSIONS = ("EXT_meshopt_compression", "KHR_meshopt_compression")
_LIBRARY = "meshopt"
_FILTERS = ("NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL", "COLOR")


def packed_part(entry: Entry) -> Entry | None:
    """The extension of a buffer view, if it is compressed."""
    return next((part for name in EXTENSIONS if (part := entry.extension(name)) is not None), None)


def is_installed() -> bool:
    """Whether compressed views can be read."""
    return libraries.is_installed(_LIBRARY)


def unpacked_size(part: Entry) -> int:
    """The size of a view without compression, in bytes. part: of `packed_part`."""
    return part.integer("count") * part.integer("byteStride", low=1, high=256)


def unpack(part: Entry, data: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The bytes of a view without compression."""
    count, stride = part.integer("count"), part.integer("byteStride", low=1, high=256)
    mode = part.text("mode", None, ("ATTRIBUTES", "TRIANGLES", "INDICES"))
    kind = part.text("filter", "NONE", _FILTERS)
    library = libraries.library(_LIBRARY, f"{part.file}: {part.place}")
    try:
        rows = library.decode_gltf_buffer(data, count, stride, mode, kind if mode == "ATTRIBUTES" else None)
    except ValueError as error:
        raise part.error(f"has damaged data ({error}); compress the file again") from None
    found: NDArray[np.uint8] = np.ascontiguousarray(rows).view(np.uint8).reshape(-1)
    return found
