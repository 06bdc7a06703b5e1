"""What the package keeps on disk because it takes long to make: compiled shaders and pipelines.

An entry is a file: the SHA-256 of its content, then the content, so that a damaged entry is noticed. It is written
atomically, so that another process sees all of it or nothing.
"""

from __future__ import annotations

import hashlib
import os
import stat
import sys
from pathlib import Path

from solari_vk.base.errors import SolariError, warn
from solari_vk.base.files import make_folder, write_whole

_OFF = ("", "0", "off", "no")
_warned_of = set[Path]()


def folder() -> Path | None:
    """The folder of the cache: SOLARI_VK_CACHE, else the platform's; None if SOLARI_VK_CACHE turns the cache off, and,
    with a warning, for users without a home."""
    named = os.environ.get("SOLARI_VK_CACHE")
    if named is not None:
        return None if named.strip().lower() in _OFF else Path(named)
    try:
        if sys.platform == "darwin":
            return Path.home() / "Library" / "Caches" / "solari_vk"
        if sys.platform == "win32":
            return Path(os.environ.get("LOCALAPPDATA") or Path.home()) / "solari_vk" / "cache"
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "solari_vk"
    except RuntimeError:
        # There is neither HOME nor an entry in the list of users, as in containers with any user's number.
        warn(
            "compiled shaders and pipelines aren't kept: this user has no home folder: set SOLARI_VK_CACHE "
            "to a folder, or to 'off'"
        )
        return None


def _trusted_folder() -> Path | None:
    """The folder; None, with a warning, where other users could put shaders of theirs into it."""
    # Drivers run what is in a pipeline cache, so that a file of somebody else would run with this user's rights.
    base = folder()
    try:
        found = base.stat() if base is not None and hasattr(os, "getuid") else None
    except OSError:
        return base  # which isn't there yet
    if found is not None and (found.st_mode & stat.S_IWOTH or found.st_uid not in (0, os.getuid())):
        warn(
            f"compiled shaders and pipelines aren't kept in {base}, where other users can write: give it to yourself "
            "with mode 700, or set SOLARI_VK_CACHE to another folder"
        )
        return None
    return base


def load(name: str) -> bytes | None:
    """The content of an entry; None if it is missing or damaged, and while the cache is off."""
    base = _trusted_folder()
    try:
        entry = (base / name).read_bytes() if base else b""
    except OSError:
        return None
    # An empty entry isn't one either: a disk that was full may have left it.
    content = entry[32:]
    return content if content and hashlib.sha256(content).digest() == entry[:32] else None


def store(name: str, content: bytes) -> None:
    """Write an entry, unless the cache is off. A folder that can't be written only gives a warning, and only one."""
    base = _trusted_folder()
    if base is None:
        return
    try:
        make_folder((base / name).parent)
        write_whole(base / name, hashlib.sha256(content).digest() + content)
    except SolariError as error:
        if base not in _warned_of:
            _warned_of.add(base)
            warn(f"compiled shaders and pipelines can't be kept: {error}, by SOLARI_VK_CACHE, or set it to 'off'")
