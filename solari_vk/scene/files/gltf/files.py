"""Whether files exist, and bytes from data URIs."""

from __future__ import annotations

import base64
import binascii
from pathlib import Path
from urllib.parse import unquote, unquote_to_bytes

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene.files.gltf.values import Entry


def exists(path: Path) -> bool:
    """Whether there is a file; OSError for a name that none can have (`Path.exists` of Python 3.14 raises nothing)."""
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    return True


def decode_data_uri(uri: str, entry: Entry) -> NDArray[np.uint8]:
    """The bytes of a URI that contains its data."""
    header, comma, body = uri.partition(",")
    try:
        if not comma:
            raise ValueError
        if header.lower().endswith(";base64"):
            body = unquote(body) if "%" in body else body
            return np.frombuffer(base64.b64decode(body + "=" * (-len(body) % 4), validate=True), np.uint8)
        return np.frombuffer(unquote_to_bytes(body), np.uint8)
    except (ValueError, binascii.Error):
        raise entry.error("has a data URI that is not valid base64; export the file again") from None
