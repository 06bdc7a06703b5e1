"""A lock for a folder that one process writes into. It ends with its process, however that ends."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import socket
import stat
import sys
import time
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary, finalize

from solari_vk.base.errors import SolariError
from solari_vk.base.files import NO_LINK, cannot_be

_LARGEST = 4096  # bytes of a lock file
# Windows removes no file that is open, so one that a process has open keeps its name, and can be taken over.
_STAYS_WHILE_OPEN = os.name == "nt"
_FLAGS = os.O_RDWR | NO_LINK | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)

if sys.platform == "win32":
    import msvcrt

    def _lock(file: int) -> None:
        # Nobody else can read a byte that is locked, so it is one behind the content.
        os.lseek(file, _LARGEST, os.SEEK_SET)
        try:
            msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
        except OSError as error:
            if error.errno in (errno.EACCES, 0):  # Wine gives no number
                raise BlockingIOError(error.errno, error.strerror) from None
            raise

else:
    import fcntl

    def _lock(file: int) -> None:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


_locks: WeakValueDictionary[Path, FolderLock] = WeakValueDictionary()


class HeldError(SolariError):
    """Another process holds the lock."""


class FolderLock:
    """Holds the lock file at `path` until the object is gone: by `flock`, which also works on NFS between machines, and
    on Windows by a lock of a byte.

    Raises HeldError if another process holds it, saying which one and for how long, and SolariError if it can't be
    written, and if something else has this name.
    """

    def __init__(self, path: Path) -> None:
        self._file = _make(path)
        finalize(self, _release, path, self._file, os.getpid())
        try:
            os.ftruncate(self._file, 0)  # it may have been a dead process's
            os.lseek(self._file, 0, os.SEEK_SET)
            os.write(self._file, json.dumps({"process": os.getpid(), "host": socket.gethostname()}).encode())
        except OSError as error:
            raise cannot_be("written", path, error) from None


def lock_folder(path: Path) -> FolderLock:
    """The lock of the file `path`, which all users of this process share."""
    # Of the folder only: a link of the lock's name is somebody else's.
    place = Path(os.path.realpath(path.parent)) / path.name
    # The system would refuse a second lock of this process too.
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
        return os.open(path, _FLAGS | flags, 0o644)
    except (FileExistsError, FileNotFoundError):
        if not path.parent.is_dir():
            raise
        return None
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise SolariError(f"{path}: is a link and no lock: remove it, or give another folder") from None
        raise


def _take(path: Path, file: int, *, is_new: bool) -> bool:
    """Lock a new file, or remove one whose process is dead; on Windows, lock that one. Returns whether the file is
    locked; else it is closed."""
    is_taken = False
    try:
        if not is_new and not _is_lock_file(file):
            raise SolariError(f"{path}: isn't a lock of this package: move it, or give another folder")
        _lock(file)
        # Before, another process may have taken the new file for one of a dead process, and removed it.
        is_there = _is_at(path, file)
        is_taken = is_there and (is_new or _STAYS_WHILE_OPEN)
        if is_there and not is_taken:
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
        os.lseek(file, 0, os.SEEK_SET)
        return dict(json.loads(os.read(file, _LARGEST)))
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
    is_ours = os.getpid() == process and _is_at(path, file)
    with contextlib.suppress(OSError):
        if is_ours and not _STAYS_WHILE_OPEN:
            path.unlink()
    os.close(file)
    with contextlib.suppress(OSError):  # of a file that another process has open by now
        if is_ours and _STAYS_WHILE_OPEN:
            path.unlink()
