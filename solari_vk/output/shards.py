"""Data sets as WebDataset has them: tar files of samples, whose files share a name up to the first dot."""

from __future__ import annotations

import io
import json
import os
import tarfile
from collections.abc import Iterable, Mapping
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from solari_vk.base.errors import SolariError
from solari_vk.base.files import make_folder, whole_file

SHARD = "{:06}.tar"


def save_shards(
    folder: str | os.PathLike[str], samples: Iterable[tuple[str, Mapping[str, Any]]], *, per_shard: int = 1000
) -> list[Path]:
    """Write samples as numbered .tar files of a folder, which is made if need be; returns their paths.

    samples: for each its key, such as "00000", and contents by suffix, such as {"png": ..., "depth.npy": ...}: bytes,
    text, paths of files, arrays (as .npy) and anything else as JSON. Equal samples give equal files. Shards of the
    folder with higher numbers, of earlier calls, are removed. Raises SolariError for keys with a dot or a slash, for
    one that comes twice, for what JSON doesn't have, and for files that can't be read or written.
    """
    if per_shard < 1:
        raise SolariError(f"save_shards: per_shard is at least 1, not {per_shard}")
    root, paths, keys = Path(folder), list[Path](), set[str]()
    make_folder(root)
    rest = iter(samples)
    while part := list(islice(rest, per_shard)):
        paths.append(root / SHARD.format(len(paths)))
        with whole_file(paths[-1]) as temporary, tarfile.open(temporary, "w", format=tarfile.PAX_FORMAT) as tar:
            for key, contents in part:
                if not key or set(key) & set("./\\") or key in keys:
                    raise SolariError(
                        f"{paths[-1]}: the key {key!r} of a sample has a dot or a slash, or is there already"
                    )
                keys.add(key)
                for suffix, content in contents.items():
                    try:
                        data = _data(content)
                    except TypeError as error:
                        raise SolariError(f"{paths[-1]}: {key}.{suffix}: {error}") from None
                    entry = tarfile.TarInfo(f"{key}.{suffix}")
                    entry.size, entry.mode = len(data), 0o644
                    tar.addfile(entry, io.BytesIO(data))
    for path in root.glob("[0-9]" * 6 + ".tar"):
        if path not in paths:
            path.unlink()
    return paths


def _data(content: Any) -> bytes:
    if isinstance(content, bytes):
        return content
    if isinstance(content, Path):
        try:
            return content.read_bytes()
        except OSError as error:
            raise SolariError(f"{content}: can't be read: {error.strerror}") from None
    if isinstance(content, np.ndarray):
        file = io.BytesIO()
        np.save(file, content)
        return file.getvalue()
    return (content if isinstance(content, str) else json.dumps(content, default=_number)).encode()


def _number(value: Any) -> Any:
    """A number of numpy as one of Python, for JSON."""
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} can't be written as JSON")
