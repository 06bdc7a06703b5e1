"""Regular files that are read, files that are written whole or not at all, and folders for them."""

from __future__ import annotations

import errno
import json
import os
import re
import secrets
import shutil
import stat
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from solari_vk.base.budget import charge, load_budget
from solari_vk.base.errors import SolariError, quoted

LARGEST_JSON = 2**26
_BYTES_PER_VALUE = 150  # of a value as a Python object with its place in a list or dict
_UNFINISHED = re.compile(r"\.(.+)\.[0-9a-f]{16}(\.[^.]*)")  # the names of `_beside`
_TRIAL = bytes(4096)  # a file of a few bytes may fit on a disk that is full


def read_regular(path: Path, who: str, length: int | None = None) -> bytes:
    """The first `length` bytes of a file, charged to the budget of what is loaded. Pipes, devices and folders are
    refused, because they may never end."""
    # Non-blocking, because opening a pipe without a writer would block. Windows has no such flag, but one for files
    # that aren't text.
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    try:
        with open(os.open(path, flags), "rb") as file:
            found = os.fstat(file.fileno())
            if not stat.S_ISREG(found.st_mode):
                raise SolariError(f"{who}: not a readable file: give the path of a regular file")
            size = found.st_size if length is None else min(found.st_size, length)
            charge(size, who, "the file")
            return file.read(size)
    except FileNotFoundError:
        raise SolariError(f"{who}: there is no such file: check the path") from None
    except (OSError, ValueError) as error:
        raise SolariError(f"{who}: can't be read: {getattr(error, 'strerror', None) or error}") from None
    except (MemoryError, OverflowError):
        raise SolariError(f"{who}: too large for this machine's memory") from None


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
    charge(_BYTES_PER_VALUE * values, who, "its JSON", working=4 * len(text))


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A temporary path in the same folder; what is written there replaces the file at `path` when the context ends.
    If that is a link, it stays, and the file that it names is replaced.

    Raises SolariError when writing fails, and leaves the file at `path` as it was.
    """
    # In the same folder, because only within a disk a file takes another one's place at once.
    temporary = _beside(path)
    try:
        _create(temporary)
        yield temporary
        os.replace(temporary, Path(os.path.realpath(path)))
    except (OSError, RuntimeError) as error:
        raise cannot_be("written", path, error) from None
    finally:
        _remove(temporary)


def write_whole(path: Path, content: str | bytes | memoryview) -> None:
    """Write a file; text as UTF-8. Raises SolariError when that fails, and leaves the file at `path` as it was."""
    with whole_file(path) as temporary:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)


def write_both(first: tuple[Path, bytes], second: tuple[Path, bytes]) -> None:
    """Write two files that belong together. Raises SolariError when that fails, and leaves both as they were."""
    path, content = first
    second_path, second_content = second
    target = Path(os.path.realpath(second_path))
    backup = _beside(second_path)
    is_replaced = False
    try:
        # The second file is replaced before the first one, with a backup. Replacing the first one is the last step, so
        # that it needs none.
        with whole_file(path) as temporary:
            temporary.write_bytes(content)
            _write_with_backup(second_path, second_content, target, backup)
            is_replaced = True
    except BaseException:
        if is_replaced and backup.exists():
            os.replace(backup, target)
        else:
            _remove(target if is_replaced else backup)
        raise
    _remove(backup)


def _write_with_backup(path: Path, content: bytes, target: Path, backup: Path) -> None:
    """Write a file, after the one at `target`, where its links lead, has another name too."""
    with whole_file(path) as temporary:
        temporary.write_bytes(content)
        if target.exists():
            _link_or_copy(target, backup)


def _link_or_copy(path: Path, other: Path) -> None:
    """Give a file another name too, or copy it where a disk has no links."""
    try:
        os.link(path, other)
    except OSError:
        shutil.copyfile(path, other)


def remove_unfinished(folder: Path, names: Collection[str]) -> None:
    """Remove from a folder what a killed process had begun to write of files with these names."""
    for path in folder.iterdir():
        found = _UNFINISHED.fullmatch(path.name)
        if found and "".join(found.groups()) in names:
            _remove(path)


def check_writable(path: Path) -> None:
    """Raise SolariError if no file can be written at a path: for what takes long to make, before it is made."""
    # Permissions don't tell: a disk may be full, mounted without writing, or of another machine.
    trial = _beside(path)
    try:
        _create(trial)
        trial.write_bytes(_TRIAL)
    except OSError as error:
        raise cannot_be("written", path, error) from None
    finally:
        _remove(trial)


def make_folder(path: Path) -> None:
    """Make a folder, and those above it, unless it is there. Raises SolariError when that fails."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise cannot_be("made", path, error) from None


def make_temporary_folder() -> Path:
    """Make a folder for temporary files, which the caller removes. Raises SolariError when that fails."""
    try:
        return Path(tempfile.mkdtemp(prefix="solari-vk-"))
    except OSError as error:
        reason = error.strerror or error
        raise SolariError(f"no folder for temporary files: {reason}: set TMPDIR to one that has room") from None


def cannot_be(done: str, path: Path, error: OSError | RuntimeError) -> SolariError:
    """The error that a file or folder can't be "written" or "made", with the remedy."""
    reason = getattr(error, "strerror", None) or error
    # The folder exists, so that it is one such as those of /proc, in which nothing can be made.
    if getattr(error, "errno", None) == errno.ENOENT:
        return SolariError(f"{path}: can't be {done}: its folder takes no files: choose another one")
    if isinstance(error, PermissionError) or getattr(error, "errno", None) == errno.EROFS:
        remedy = "choose a folder that can be written"
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
    try:
        target = Path(os.path.realpath(path))
    except ValueError:
        raise SolariError(f"{quoted(str(path))}: has a null character: choose another name") from None
    if not os.path.isdir(target.parent):
        raise SolariError(f"{path}: there is no folder {target.parent}: make it first")
    # Writers choose the format by the suffix. `_UNFINISHED` matches such a name.
    return target.with_name(f".{target.stem}.{secrets.token_hex(8)}{path.suffix}")


def _create(path: Path) -> None:
    """Make an empty file; OSError if there is anything of this name, such as a link that somebody put there."""
    os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))


def _remove(temporary: Path) -> None:
    with suppress(OSError):
        temporary.unlink(missing_ok=True)
