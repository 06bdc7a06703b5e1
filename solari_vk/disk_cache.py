"""What the package keeps on disk because it takes long to make: compiled shaders and pipelines.

An entry is a file: the SHA-256 of its content, then the content, so that a damaged entry is noticed. It is written
atomically, so that another process sees all of it or nothing.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
import tempfile
import warnings
from pathlib import Path

_OFF = ("", "0", "off", "no")


def folder() -> Path | None:
    """The folder of the cache: SOLARI_VK_CACHE, else the platform's; None if SOLARI_VK_CACHE turns the cache off."""
    named = os.environ.get("SOLARI_VK_CACHE")
    if named is not None:
        return None if named.strip().lower() in _OFF else Path(named)
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "solari_vk"
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home())) / "solari_vk" / "cache"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "solari_vk"


def load(name: str) -> bytes | None:
    """The content of an entry; None if it is missing or damaged, and while the cache is off."""
    base = folder()
    try:
        entry = (base / name).read_bytes() if base else b""
    except OSError:
        return None
    content = entry[32:]
    return content if content and hashlib.sha256(content).digest() == entry[:32] else None


def store(name: str, content: bytes) -> None:
    """Write an entry, unless the cache is off. A folder that can't be written only gives a warning."""
    base = folder()
    if base is None:
        return
    try:
        _write(base / name, hashlib.sha256(content).digest() + content)
    except OSError as error:
        warnings.warn(
            f"compiled shaders and pipelines can't be kept in {base} ({error.strerror}); set SOLARI_VK_CACHE to a "
            "folder that can be written, or to 'off'",
            stacklevel=3,
        )


def _write(file: Path, content: bytes) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=file.parent, suffix=".tmp")
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
        os.replace(temporary, file)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(temporary)
        raise
