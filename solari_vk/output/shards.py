"""Data sets as WebDataset has them: tar files of samples, whose files share a name up to the first dot."""

from __future__ import annotations

import io
import json
import os
import tarfile
from collections.abc import Container, Iterable, Mapping
from itertools import count, islice
from pathlib import Path
from typing import Any

import numpy as np

from solari_vk.base.errors import SolariError, checked_keywords
from solari_vk.base.files import make_folder, read_regular, whole_file

SHARD = "{:06}.tar"


@checked_keywords(who="solari_vk")
def save_shards(
    folder: str | os.PathLike[str], samples: Iterable[tuple[str, Mapping[str, Any]]], *, per_shard: int = 1000
) -> list[Path]:
    """Write samples as numbered .tar files of a folder, which is made if need be; returns their paths.

    samples: for each its key, such as "00000", and contents by suffix, such as {"png": ..., "depth.npy": ...}: bytes,
    text, paths of files, arrays (as .npy) and anything else as JSON. Equal samples give equal files. The shards
    after them, of an earlier call, are removed. Raises SolariError for keys with a dot or a slash, for
    one that comes twice, for what JSON doesn't have, and for files that can't be read or written.
    """
    if per_shard < 1:
        raise SolariError(f"save_shards: per_shard is at least 1, not {per_shard}")
    root = Path(folder)
    make_folder(root)
    paths: list[Path] = []
    keys: set[str] = set()
    rest = iter(samples)
    while part := list(islice(rest, per_shard)):
        path = root / SHARD.format(len(paths))
        _write_shard(path, part, keys)
        paths.append(path)
    # Those of an earlier call with more samples would be read as part of this one. Their numbers go on without a gap,
    # so that files behind a gap are the user's.
    for number in count(len(paths)):
        path = root / SHARD.format(number)
        if not path.is_file():
            break
        path.unlink()
    return paths


def _write_shard(path: Path, samples: Iterable[tuple[str, Mapping[str, Any]]], keys: set[str]) -> None:
    """Write a .tar file. keys: those of the folder, to which the samples' are added."""
    with whole_file(path) as temporary, tarfile.open(temporary, "w", format=tarfile.PAX_FORMAT) as tar:
        for key, contents in samples:
            _check_key(key, keys, path)
            keys.add(key)
            for suffix, content in contents.items():
                _add_file(tar, f"{key}.{suffix}", content, path)


def _check_key(key: str, known: Container[str], path: Path) -> None:
    # Readers take the name of a file up to its first dot for the key of its sample.
    if not key or set(key) & set("./\\") or key in known:
        raise SolariError(f"{path}: the key {key!r} of a sample has a dot or a slash, or is there already")


def _add_file(tar: tarfile.TarFile, name: str, content: Any, path: Path) -> None:
    try:
        data = _bytes_of(content)
    except TypeError as error:
        raise SolariError(f"{path}: {name}: {error}") from None
    # Neither time nor owner, so that equal samples give equal files.
    entry = tarfile.TarInfo(name)
    entry.size = len(data)
    entry.mode = 0o644
    tar.addfile(entry, io.BytesIO(data))


def _bytes_of(content: Any) -> bytes:
    if isinstance(content, bytes):
        return content
    if isinstance(content, Path):
        return read_regular(content, f"{content}")
    if isinstance(content, np.ndarray):
        file = io.BytesIO()
        np.save(file, content)
        return file.getvalue()
    text = content if isinstance(content, str) else json.dumps(content, default=_number)
    return text.encode()


def _number(value: Any) -> Any:
    """A number of numpy as one of Python, for JSON."""
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} can't be written as JSON")
