"""What the package keeps on disk because it takes long to make: compiled shaders and pipelines, measured speeds.

An entry is a file: the SHA-256 of its content, then the content, so that a damaged entry is noticed. It is written
atomically, so that another process sees all of it or nothing.
"""

from __future__ import annotations

import hashlib
import os
import stat
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from solari_vk.base.errors import SolariError, warn
from solari_vk.base.files import is_trusted_owner, make_folder, open_regular, whole_file
from solari_vk.base.folder_lock import HeldError, lock_folder

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
    way_in = _way_in((base / name).parent)
    if way_in is None:
        return base, (base / name).parent
    _warn_once(
        base,
        f"compiled shaders and pipelines aren't kept in {base}: {way_in}: give it to yourself with mode 700, or set "
        "SOLARI_VK_CACHE to another folder",
    )
    return None


def _way_in(path: Path) -> str | None:
    """How other users could put a file into a folder: what is wrong with one on the way to it; None if nothing is.

    OpenSSH asks the same of the folders of its keys (StrictModes)."""
    if not hasattr(os, "geteuid"):
        return None
    # One name after the other, as the system itself follows a path: what a link names takes the link's place.
    here = Path("/")
    names = list((Path.cwd() / path).parts[1:])
    link_count = 0
    while True:
        wrong = _fault_of(here, is_last=not names)
        if wrong or not names:
            return wrong
        name = names.pop(0)
        after = here.parent if name == ".." else here / name
        if after.is_symlink():
            link_count += 1
            owner = os.lstat(after)
            is_ours = is_trusted_owner(owner) or owner.st_uid == _unknown_user()
            if link_count > _MAX_LINKS or not is_ours:
                return f"{after} is a link that can't be trusted"
            target = here / os.readlink(after)
            names = [*target.parts[1:], *names]
            after = Path("/")
        here = after


def _fault_of(folder: Path, *, is_last: bool) -> str | None:
    try:
        found = os.stat(folder)
    except OSError:
        return None  # isn't there yet
    is_ours = is_trusted_owner(found) or (not is_last and found.st_uid == _unknown_user())
    if not is_ours:
        return f"{folder} is another user's"
    # In a folder such as /tmp, which is sticky, nobody moves what is somebody else's. But anybody adds to it.
    is_protected = bool(found.st_mode & stat.S_ISVTX) and not is_last
    return f"other users can write to {folder}" if _others_can_write(found) and not is_protected else None


@cache
def _unknown_user() -> int | None:
    """The number that files of users outside of this user namespace have, such as those of the root of a container's
    host; None outside of a namespace."""
    try:
        number = int(Path("/proc/sys/kernel/overflowuid").read_text())
        known = [list(map(int, line.split())) for line in Path("/proc/self/uid_map").read_text().splitlines()]
    except (OSError, ValueError):
        return None
    return None if any(first <= number < first + count for first, _, count in known) else number


def _others_can_write(found: os.stat_result) -> bool:
    if not hasattr(os, "geteuid"):
        return False  # Windows keeps rights in lists, and says of every file that all may write it
    if found.st_mode & stat.S_IWOTH:
        return True
    return bool(found.st_mode & stat.S_IWGRP) and not _is_own_group(found.st_gid)


@cache
def _is_own_group(number: int) -> bool:
    """Whether a group has this user only, as is usual where 002 is the umask: it is named like the user, and has no
    other members."""
    if sys.platform == "win32":
        return False  # has no such groups
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
            # Of a time before the folder was this user's alone.
            entry_status = os.fstat(file.fileno())
            if not is_trusted_owner(entry_status) or _others_can_write(entry_status):
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
        with whole_file(base / name, mode=0o600) as temporary:
            temporary.write_bytes(hashlib.sha256(content).digest() + content)
    except SolariError as error:
        _warn_once(
            base, f"compiled shaders and pipelines can't be kept: {error}, by SOLARI_VK_CACHE, or set it to 'off'"
        )


@contextmanager
def alone(name: str, seconds: float) -> Iterator[None]:
    """A context that processes enter one after the other, to make an entry once. Nobody waits longer than this, nor
    where the cache is off or can't be written."""
    found = _trusted_folder(name)
    lock = None
    until = time.monotonic() + seconds
    while found and lock is None and time.monotonic() < until:
        try:
            make_folder(found[1], mode=0o700)
            lock = lock_folder(found[1] / f"{name}.lock")
        except HeldError:
            time.sleep(0.05)
        except SolariError:
            break
    yield
    del lock  # which was held until here
