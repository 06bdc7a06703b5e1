"""A lock for a folder that one process writes into. It ends with its process, however that ends."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import socket
import stat
import time
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary, finalize

from solari_vk.base.errors import SolariError
from solari_vk.base.files import NO_LINK, cannot_be

try:
    import fcntl
except ImportError:  # Windows: folders aren't locked there
    fcntl = None  # type: ignore[assignment]

_LARGEST = 4096  # bytes of a lock file

_locks: WeakValueDictionary[Path, FolderLock] = WeakValueDictionary()


class HeldError(SolariError):
    """Another process holds the lock."""


class FolderLock:
    """Holds the lock file at `path` until the object is gone: `flock`, which also works on NFS between machines.

    Raises HeldError if another process holds it, saying which one and for how long, and SolariError if it can't be
    written, and if something else has this name.
    """

    def __init__(self, path: Path) -> None:
        if fcntl is None:
            return
        self._file = _make(path)
        finalize(self, _release, path, self._file, os.getpid())
        try:
            os.write(self._file, json.dumps({"process": os.getpid(), "host": socket.gethostname()}).encode())
        except OSError as error:
            raise cannot_be("written", path, error) from None


def lock_folder(path: Path) -> FolderLock:
    """The lock of the file `path`, which all users of this process share."""
    # Of the folder only: a link of the lock's name is somebody else's.
    place = Path(os.path.realpath(path.parent)) / path.name
    # `flock` would refuse a second lock of this process too.
    lock = _locks.get(place)
    if lock is None:
        lock = FolderLock(place)
        _locks[place] = lock
    return lock


def _make(path: Path) -> int:
    """An empty file that this process made at `path` and has locked."""
    while True:
        try:
            new = _open(path, os.O_CREAT | os.O_EXCL)
            file = _open(path, 0) if new is None else new
            # None: what had the name is gone by now. The file of a dead process is removed, and then made anew.
            if file is not None and _take(path, file, is_new=new is not None):
                return file
        except OSError as error:
            raise cannot_be("locked", path, error) from None


def _open(path: Path, flags: int) -> int | None:
    """A file to read and write, not through a link; None if it is there and must be new, or the other way round."""
    try:
        # Non-blocking, because opening a pipe would wait for its other end.
        return os.open(path, os.O_RDWR | NO_LINK | os.O_NONBLOCK | flags, 0o644)
    except (FileExistsError, FileNotFoundError):
        if not path.parent.is_dir():
            raise
        return None
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise SolariError(f"{path}: is a link and no lock: remove it, or give another folder") from None
        raise


def _take(path: Path, file: int, *, is_new: bool) -> bool:
    """Lock a new file, or remove one whose process is dead. Returns whether a new file is locked; else it is closed."""
    is_taken = False
    try:
        if not is_new and not _is_lock_file(file):
            raise SolariError(f"{path}: isn't a lock of this package: move it, or give another folder")
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # Before, another process may have taken the new file for one of a dead process, and removed it.
        is_there = _is_at(path, file)
        is_taken = is_new and is_there
        if is_there and not is_new:
            path.unlink()
        return is_taken
    except BlockingIOError:
        if is_new:
            return False
        raise HeldError(f"{path.parent}: {_owner(file)}: wait for it, or give another folder") from None
    except OSError:  # a disk without locks
        if is_new and _is_at(path, file):
            path.unlink()
        raise
    finally:
        if not is_taken:
            os.close(file)


def _is_at(path: Path, file: int) -> bool:
    try:
        return os.path.samestat(os.fstat(file), os.lstat(path))
    except OSError:
        return False


def _is_lock_file(file: int) -> bool:
    """Whether a file is empty, as one is whose process was killed before it wrote, or has what a lock has."""
    found = os.fstat(file)
    if not stat.S_ISREG(found.st_mode) or found.st_size > _LARGEST or found.st_nlink > 1:
        return False
    return found.st_size == 0 or _content(file).keys() == {"process", "host"}


def _content(file: int) -> dict[str, Any]:
    try:
        return dict(json.loads(os.pread(file, _LARGEST, 0)))
    except (ValueError, TypeError, RecursionError):
        return {}


def _owner(file: int) -> str:
    """Who holds a lock, as its file says."""
    age = max(time.time() - os.fstat(file).st_mtime, 0.0)
    owner = _content(file)
    who = f"process {owner['process']} on {owner['host']}" if owner else "another process"
    return f"{who} has written into it for {age / 60:.0f} minutes" if age > 90 else f"{who} writes into it"


def _release(path: Path, file: int, process: int) -> None:
    # A forked process has the same objects, and isn't the owner. The file is removed while the lock still holds, and
    # only if it is the one that was made: it may have been replaced by another of its name.
    with contextlib.suppress(OSError):
        if os.getpid() == process and _is_at(path, file):
            path.unlink()
    os.close(file)
