"""A lock for a folder that one process writes into. It ends with its process, however that ends."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import time
from pathlib import Path
from weakref import WeakValueDictionary, finalize

from solari_vk.base.errors import SolariError
from solari_vk.base.files import cannot_be

try:
    import fcntl
except ImportError:  # Windows: folders aren't locked there
    fcntl = None  # type: ignore[assignment]

_locks: WeakValueDictionary[Path, FolderLock] = WeakValueDictionary()


class FolderLock:
    """Holds the lock file at `path` until the object is gone: `flock`, which also works on NFS between machines.

    Raises SolariError if another process holds it, saying which one and for how long, and if it can't be written.
    """

    def __init__(self, path: Path) -> None:
        self._file = self._open(path)
        finalize(self, _release, path, self._file)
        try:
            os.truncate(self._file, 0)
            os.write(self._file, json.dumps({"process": os.getpid(), "host": socket.gethostname()}).encode())
        except OSError as error:
            raise cannot_be("written", path, error) from None

    @staticmethod
    def _open(path: Path) -> int:
        while True:
            try:
                file = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o644)
            except OSError as error:
                raise cannot_be("written", path, error) from None
            if fcntl is None:
                return file
            # Between `open` and `flock` the owner may have removed its file: then this lock is of a file that nobody
            # else will find, and the next round makes a new one.
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if os.path.samestat(os.fstat(file), os.stat(path)):
                    return file
            except FileNotFoundError:
                pass
            except OSError:
                raise SolariError(f"{path.parent}: {_owner(file)}: wait for it, or give another folder") from None
            os.close(file)


def lock_folder(path: Path) -> FolderLock:
    """The lock of the file `path`, which all users of this process share."""
    place = Path(os.path.realpath(path))
    # `flock` would refuse a second lock of this process too.
    lock = _locks.get(place)
    if lock is None:
        lock = FolderLock(place)
        _locks[place] = lock
    return lock


def _owner(file: int) -> str:
    """Who holds a lock, as its file says."""
    age = max(time.time() - os.fstat(file).st_mtime, 0.0)
    try:
        owner = json.loads(os.pread(file, 4096, 0))
        who = f"process {owner['process']} on {owner['host']}"
    except (ValueError, KeyError, TypeError):
        who = "another process"
    return f"{who} has written into it for {age / 60:.0f} minutes" if age > 90 else f"{who} writes into it"


def _release(path: Path, file: int) -> None:
    # Removed while the lock still holds, so that nobody else's file is.
    with contextlib.suppress(OSError):
        path.unlink(missing_ok=True)
    os.close(file)
