"""Regular files that are read, files that are written whole or not at all, and folders for them."""

from __future__ import annotations

import errno
import io
import json
import math
import os
import re
import secrets
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.budget import charge, load_budget, string_bytes
from solari_vk.base.errors import SolariError, quoted

LARGEST_JSON = 2**26
NO_LINK = getattr(os, "O_NOFOLLOW", 0)  # which Windows lacks
_LINES_PER_LOOK = 4096
_MAX_LINKS = 40  # in a row, as Linux follows them
_LFS_POINTER = b"version https://git-lfs.github.com/spec/"
_BYTES_PER_VALUE = 150  # of a value as a Python object with its place in a list or dict
_UNFINISHED = re.compile(r"\.(.+)\.[0-9a-f]{16}(\.[^.]*)")  # the names of `_beside`
_TRIAL = bytes(4096)  # a file of a few bytes may fit on a disk that is full
# Errors of Windows: access denied, as for files that are being deleted, and a file that another program has open.
_IN_USE = (5, 32)
_IN_USE_SECONDS = 1.0  # that indexers and virus scanners may have a new file open
_TOO_LONG = (3, 206)  # errors of Windows: no such path, which it also says of long ones, and too long a name
_LONGEST_PATH = 259  # on Windows, where long paths aren't enabled
_LONGER = 18  # characters that the name of `_beside` has more


@contextmanager
def open_regular(path: Path, who: str, *, follow: bool = True) -> Iterator[io.BufferedReader]:
    """A file to read from. Pipes, devices and folders are refused, because they may never end, and links without
    `follow`. Raises SolariError for a file that can't be opened or read."""
    # Non-blocking, because opening a pipe without a writer would block. Windows has no such flag, but one for files
    # that aren't text.
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    if not follow:
        flags |= NO_LINK
    try:
        with open(os.open(path, flags), "rb") as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise SolariError(f"{who}: not a readable file: give the path of a regular file")
            yield file
    except FileNotFoundError:
        raise SolariError(f"{who}: there is no such file: check the path") from None
    except (OSError, ValueError) as error:
        if isinstance(error, PermissionError) and path.is_dir():  # Windows opens no folders
            raise SolariError(f"{who}: not a readable file: give the path of a regular file") from None
        raise SolariError(f"{who}: can't be read: {getattr(error, 'strerror', None) or error}") from None
    except (MemoryError, OverflowError):
        raise SolariError(f"{who}: too large for this machine's memory") from None


def read_regular(path: Path, who: str, length: int | None = None, *, follow: bool = True) -> bytes:
    """The first `length` bytes of a file of `open_regular`, charged to the budget of what is loaded."""
    with open_regular(path, who, follow=follow) as file:
        size = os.fstat(file.fileno()).st_size
        size = size if length is None else min(size, length)
        charge(size, who, "the file")
        content = file.read(max(size, len(_LFS_POINTER)))  # a pointer is named as such whatever the length
    if content.startswith(_LFS_POINTER):
        raise SolariError(
            f"{who}: a pointer of Git LFS, which stands for the file: get the file itself by `git lfs pull`"
        )
    return content[:size]


def read_json(path: Path, who: str) -> Any:
    """The values of a JSON file of at most 64 MiB. Raises SolariError for what isn't one."""
    with load_budget():
        data = read_regular(path, who, LARGEST_JSON + 1)
        if len(data) > LARGEST_JSON:
            raise SolariError(f"{who}: has more than {LARGEST_JSON >> 20} MiB: split it")
        charge_json(data, who)
    try:
        return json.loads(data)
    except (ValueError, RecursionError) as error:
        raise SolariError(f"{who}: not JSON: {error}") from None


def charge_json(text: bytes, who: str) -> None:
    """Charge the values of a JSON text as Python objects."""
    # Each value follows a comma or opens an object or a list, so that the text needn't be parsed to count them.
    values = sum(map(text.count, (b",", b"{", b"[")))
    # The strings are parts of the text, which is one string while it is parsed. json.loads also takes UTF-16.
    size = string_bytes(text) if json.detect_encoding(text).startswith("utf-8") else 2 * len(text)
    charge(_BYTES_PER_VALUE * values + size, who, "its JSON", working=size)


def text_lines(data: bytes, who: str) -> Iterator[tuple[int, str]]:
    """The numbered lines of a text in UTF-8 without their ends, one after the other, so that they take no memory."""
    charge(0, who, "its text", working=string_bytes(data))  # for it may be one line
    lines = io.TextIOWrapper(io.BytesIO(data), "utf-8-sig", errors="replace")
    for number, line in enumerate(lines, 1):
        if number % _LINES_PER_LOOK == 0:
            charge(0, who, "its text")  # looks at the time
        yield number, line.rstrip("\n")


def followed(path: Path) -> Path:
    """The path to write where the user named `path`: what its links lead to. Raises SolariError for a link of another
    user in a folder to which others can write, and for one to a name with another ending, by which writers choose the
    format."""
    named = path
    try:
        for _ in range(_MAX_LINKS):
            if not path.is_symlink():
                break
            if _is_planted(path):
                raise SolariError(f"{path}: is a link of another user: remove it, or choose another name")
            target = path.parent / os.readlink(path)
            if target.exists() and not target.is_file():
                break  # a pipe or a device, which the writer refuses by the name that the user knows
            path = target
    except (OSError, ValueError):
        pass  # There is no such file yet, or no file can have this name, which the writer says.
    if path.suffix.lower() != named.suffix.lower():
        raise SolariError(
            f"{named}: is a link to {path}, whose name ends otherwise: name that file itself, or remove it"
        )
    return path


def _is_planted(link: Path) -> bool:
    # Anybody can put a link into a folder such as /tmp, which then leads to a file of this user. Linux doesn't follow
    # such links either (fs.protected_symlinks).
    found = os.lstat(link)
    folder = os.stat(link.parent)
    others_write = bool(folder.st_mode & (stat.S_IWOTH | stat.S_IWGRP))
    return others_write and not is_trusted_owner(found) and found.st_uid != folder.st_uid


def is_trusted_owner(found: os.stat_result) -> bool:
    """Whether a file is this user's or root's."""
    return not hasattr(os, "geteuid") or found.st_uid in (0, os.geteuid())


def read_npy(path: Path, who: str) -> NDArray[Any]:
    """The array of a .npy file. Raises SolariError for what isn't one, and for one of objects, which could run code."""
    with load_budget():
        data = read_regular(path, who)
    try:
        file = io.BytesIO(data)
        version = np.lib.format.read_magic(file)
        header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, is_fortran, dtype = header(file)
        # numpy itself would make room for whatever the header names.
        size = math.prod(shape) * dtype.itemsize
        if dtype.hasobject or dtype.itemsize == 0 or size != len(data) - file.tell():
            raise ValueError("its content has another size than its header says")
        return np.frombuffer(data, dtype, offset=file.tell()).reshape(shape, order="F" if is_fortran else "C").copy()
    except Exception as error:  # numpy raises many types of exceptions for damaged headers
        raise SolariError(f"{who}: can't be read as an array: {quoted(str(error))}: make it anew") from None


@contextmanager
def whole_file(path: Path, mode: int = 0o666) -> Iterator[Path]:
    """A temporary path in the same folder; what is written there replaces what is at `path` when the context ends: a
    file, whose owner and mode the new one gets, or a link, but not what it leads to: for that give `followed(path)`.
    mode: of a file where none was.

    Raises SolariError when writing fails, and leaves the file at `path` as it was.
    """
    # In the same folder, because only within a disk a file takes another one's place at once.
    temporary = _beside(path)
    try:
        old = _old_file(path)
        _create(temporary, mode if old is None else 0o600)
        yield temporary
        if old is not None:
            _keep_mode(temporary, old)
        replace(temporary, path)
    except (OSError, RuntimeError) as error:
        raise cannot_be("written", path, error) from None
    finally:
        _remove(temporary)


def replace(source: Path, target: Path) -> None:
    """`os.replace`, which Windows refuses while another program has one of the files open: it is tried for a second,
    since indexers and virus scanners look into new files. Raises OSError."""
    until = time.monotonic() + _IN_USE_SECONDS
    while True:
        try:
            os.replace(source, target)
            return
        except PermissionError as error:
            if getattr(error, "winerror", None) not in _IN_USE or time.monotonic() > until:
                raise
            time.sleep(0.02)


def write_whole(path: Path, content: str | bytes | memoryview) -> None:
    """Write a file; text as UTF-8. Raises SolariError when that fails, and leaves the file at `path` as it was."""
    with whole_file(path) as temporary:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)


def write_both(first: tuple[Path, bytes], second: tuple[Path, bytes]) -> None:
    """Write two files that belong together. Raises SolariError when that fails, and leaves both as they were."""
    path, content = first
    second_path, second_content = second
    backup = _beside(second_path)
    is_replaced = False
    try:
        # The second file is replaced before the first one, with a backup. Replacing the first one is the last step, so
        # that it needs none.
        with whole_file(path) as temporary:
            temporary.write_bytes(content)
            _write_with_backup(second_path, second_content, backup)
            is_replaced = True
    except BaseException:
        if is_replaced and os.path.lexists(backup):
            replace(backup, second_path)
        else:
            _remove(second_path if is_replaced else backup)
        raise
    _remove(backup)


def _write_with_backup(path: Path, content: bytes, backup: Path) -> None:
    """Write a file, after the one that is there has another name too."""
    with whole_file(path) as temporary:
        temporary.write_bytes(content)
        if os.path.lexists(path):
            _link_or_copy(path, backup)


def _link_or_copy(path: Path, other: Path) -> None:
    """Give a file another name too, or copy it where a disk has no links."""
    try:
        os.link(path, other, follow_symlinks=False)
    except (OSError, NotImplementedError):
        shutil.copy2(path, other, follow_symlinks=False)


def remove_unfinished(folder: Path, names: Collection[str]) -> None:
    """Remove from a folder what a killed process had begun to write of files with these names, and the folders that
    `make_beside` made for them."""
    for path in folder.iterdir():
        found = _UNFINISHED.fullmatch(path.name)
        if found and "".join(found.groups()) in names:
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                _remove(path)


def check_writable(path: Path) -> None:
    """Raise SolariError if no file can be written at a path: for what takes long to make, before it is made."""
    # Permissions don't tell: a disk may be full, mounted without writing, or of another machine.
    path = followed(path)
    trial = _beside(path)
    try:
        _old_file(path)
        _create(trial, 0o600)
        trial.write_bytes(_TRIAL)
    except OSError as error:
        raise cannot_be("written", path, error) from None
    finally:
        _remove(trial)


def make_folder(path: Path, mode: int = 0o777) -> None:
    """Make a folder, and those above it, unless it is there. Raises SolariError when that fails."""
    try:
        for part in (*reversed(path.parents), path):
            part.mkdir(mode, exist_ok=True)
    except OSError as error:
        raise cannot_be("made", path, error) from None


def make_temporary_folder() -> Path:
    """Make a folder for temporary files, which the caller removes. Raises SolariError when that fails."""
    try:
        return Path(tempfile.mkdtemp(prefix="solari-vk-"))
    except OSError as error:
        reason = error.strerror or error
        raise SolariError(f"no folder for temporary files: {reason}: set TMPDIR to one that has room") from None


def make_beside(path: Path) -> Path:
    """Make a folder beside `path` that nobody can foresee, for files that will replace those there; the caller removes
    it. Raises SolariError when that fails."""
    folder = _beside(path)
    try:
        folder.mkdir()
        folder.chmod(stat.S_IMODE(path.parent.stat().st_mode))  # whoever may write there may write here too
    except OSError as error:
        raise cannot_be("made", folder, error) from None
    return folder


def cannot_be(done: str, path: Path, error: OSError | RuntimeError) -> SolariError:
    """The error that a file or folder can't be "written" or "made", with the remedy."""
    reason = getattr(error, "strerror", None) or error
    in_windows = getattr(error, "winerror", None)
    if in_windows in _TOO_LONG and len(os.path.abspath(path)) + _LONGER > _LONGEST_PATH:
        remedy = "choose a shorter path, or enable long paths in Windows"
    elif in_windows in _IN_USE and path.is_file():
        remedy = "close the program that has it open, make it writable, or choose another name"
    elif isinstance(error, PermissionError) or getattr(error, "errno", None) == errno.EROFS:
        remedy = "choose a folder that can be written"
    elif getattr(error, "errno", None) == errno.ENOENT:
        # The folder exists, so that it is one such as those of /proc, in which nothing can be made.
        return SolariError(f"{path}: can't be {done}: its folder takes no files: choose another one")
    elif getattr(error, "errno", None) == errno.ENAMETOOLONG:
        remedy = "choose a shorter name"
    elif isinstance(error, RuntimeError):
        remedy = "make room there, choose another folder, or mend what the reason names"
    else:
        remedy = "make room there, or choose another folder"
    return SolariError(f"{path}: can't be {done}: {reason}: {remedy}")


def _beside(path: Path) -> Path:
    """A path in the same folder, with the same suffix, that nobody can foresee."""
    if os.path.exists(path) and not os.path.isfile(path):
        raise SolariError(f"{path}: is a {'folder' if path.is_dir() else 'device or pipe'}: give the name of a file")
    if "\0" in str(path):
        raise SolariError(f"{quoted(str(path))}: has a null character: choose another name")
    if not os.path.isdir(path.parent):
        raise SolariError(f"{path}: there is no folder {path.parent}: make it first")
    # Windows alone has this function, from Python 3.13 on. What is written to "nul.png" or "a:b.png" would be lost.
    is_reserved = getattr(os.path, "isreserved", None)
    if is_reserved is not None and is_reserved(path.name):
        raise SolariError(f"{path}: is a name that Windows keeps for itself, or has a character that it doesn't allow")
    # Writers choose the format by the suffix. `_UNFINISHED` matches such a name.
    return path.with_name(f".{path.stem}.{secrets.token_hex(8)}{path.suffix}")


def _old_file(path: Path) -> os.stat_result | None:
    """The file that one at `path` will replace; None for a link or nothing. OSError if it may not be written."""
    try:
        found = os.lstat(path)
    except FileNotFoundError:
        return None
    if not stat.S_ISREG(found.st_mode):
        return None
    # Its folder would let it be replaced, but whoever made it read-only wanted to keep it.
    if not os.access(path, os.W_OK):
        raise PermissionError(errno.EACCES, "the file there is read-only")
    return found


def _keep_mode(path: Path, old: os.stat_result) -> None:
    """Give a file the owner, group and mode of the one that it replaces, and nobody more than that."""
    if sys.platform == "win32":
        return  # has none of these
    mode = stat.S_IMODE(old.st_mode) & 0o777
    new = os.stat(path)
    if new.st_gid != old.st_gid:
        try:
            os.chown(path, -1, old.st_gid)
        except OSError:
            mode &= 0o707  # of another group
    if new.st_uid != old.st_uid:
        with suppress(OSError):  # only root may
            os.chown(path, old.st_uid, -1)
    # Some disks have no modes. The file has a narrower one so far.
    with suppress(OSError):
        os.chmod(path, mode)


def _create(path: Path, mode: int) -> None:
    """Make an empty file; OSError if there is anything of this name, such as a link that somebody put there."""
    os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, mode))


def _remove(temporary: Path) -> None:
    with suppress(OSError):
        temporary.unlink(missing_ok=True)
