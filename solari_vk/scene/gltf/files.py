"""Bytes from regular files and from data URIs."""

from __future__ import annotations

import base64
import binascii
import os
import stat
from pathlib import Path
from urllib.parse import unquote, unquote_to_bytes

import numpy as np
from numpy.typing import NDArray

from solari_vk.errors import SolariError
from solari_vk.scene.gltf.values import Entry


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


def read_regular(path: Path, who: str, length: int | None = None) -> bytes:
    """The first `length` bytes of a file; pipes, devices and folders are refused, because they may never end."""
    try:
        # Non-blocking, because opening a pipe without a writer would block.
        with open(os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)), "rb") as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise SolariError(f"{who}: not a readable file: give the path of a regular file")
            return file.read(-1 if length is None else length)
    except FileNotFoundError:
        raise SolariError(f"{who}: there is no such file: check the path") from None
    except (OSError, ValueError) as error:
        raise SolariError(f"{who}: can't be read: {getattr(error, 'strerror', None) or error}") from None
    except (MemoryError, OverflowError):
        raise SolariError(f"{who}: too large for this machine's memory") from None
