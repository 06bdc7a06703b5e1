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
from solari_vk.base.files import is_trusted_owner, make_folder, open_regular, write_whole

_OFF = ("", "0", "off", "no")
_MAX_LINKS = 40
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


def _trusted_folder(name: str) -> tuple[Path, Path] | None:
    """The cache's folder and that of an entry; None, with a warning, where other users could put shaders of theirs."""
    # Drivers run what is in a pipeline cache, so that a file of somebody else would run with this user's rights.
    base = folder()
    if base is None:
        return None
    writable = _writable_by_others((base / name).parent)
    if writable is None:
        return base, (base / name).parent
    _warn_once(
        base,
        f"compiled shaders and pipelines aren't kept in {base}: other users can write to {writable}: give it to "
        "yourself with mode 700, or set SOLARI_VK_CACHE to another folder",
    )
    return None


def _writable_by_others(path: Path) -> Path | None:
    """The folder on the way to a folder that other users can write to, or that is another user's; None if none is.

    OpenSSH asks the same of the folders of its keys (StrictModes)."""
    if not hasattr(os, "geteuid"):
        return None
    ways = [Path(os.path.abspath(path))]
    for way in ways:
        for part in (way, *way.parents):
            try:
                entry, found = os.lstat(part), os.stat(part)
            except OSError:
                continue  # isn't there yet
            # In a folder such as /tmp, which is sticky, nobody moves what is somebody else's. But anybody adds to it.
            protects = bool(found.st_mode & stat.S_ISVTX) and part != way
            is_ours = is_trusted_owner(entry) and is_trusted_owner(found)
            if not is_ours or (_others_can_write(found) and not protects):
                return part
            if stat.S_ISLNK(entry.st_mode):
                # The way on, which goes through other folders.
                ways.append(Path(os.path.abspath(part.parent / os.readlink(part) / way.relative_to(part))))
        if len(ways) > _MAX_LINKS:
            return way
    return None


def _others_can_write(found: os.stat_result) -> bool:
    if found.st_mode & stat.S_IWOTH:
        return True
    return bool(found.st_mode & stat.S_IWGRP) and not _is_own_group(found.st_gid)


def _is_own_group(number: int) -> bool:
    """Whether a group has this user only, as is usual where 002 is the umask: it is named like the user, and has no
    other members."""
    import grp
    import pwd

    try:
        user, group = pwd.getpwuid(os.geteuid()).pw_name, grp.getgrgid(number)
    except KeyError:
        return False
    return group.gr_name == user and set(group.gr_mem) <= {user}


def _warn_once(base: Path, text: str) -> None:
    if base not in _warned_of:
        _warned_of.add(base)
        warn(text)


def load(name: str) -> bytes | None:
    """The content of an entry; None if it is missing, damaged or another user's, and while the cache is off."""
    found = _trusted_folder(name)
    if found is None:
        return None
    path = found[0] / name
    try:
        with open_regular(path, str(path), follow=False) as file:
            # Of a time before the folder was this user's.
            if not is_trusted_owner(os.fstat(file.fileno())):
                return None
            entry = file.read()
    except SolariError:
        return None
    # An empty entry isn't one either: a disk that was full may have left it.
    content = entry[32:]
    return content if content and hashlib.sha256(content).digest() == entry[:32] else None


def store(name: str, content: bytes) -> None:
    """Write an entry, unless the cache is off. A folder that can't be written only gives a warning, and only one."""
    found = _trusted_folder(name)
    if found is None:
        return
    base, parent = found
    try:
        make_folder(parent, mode=0o700)
        write_whole(base / name, hashlib.sha256(content).digest() + content)
    except SolariError as error:
        _warn_once(
            base, f"compiled shaders and pipelines can't be kept: {error}, by SOLARI_VK_CACHE, or set it to 'off'"
        )
