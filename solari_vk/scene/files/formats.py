"""The file formats that scenes are read from and written to, by suffix.

A format is a module or a package of this folder, which registers its functions by `reads` and `writes`. All of this
folder is imported when a file is first read or written. scene/load.py imports the formats by name as well, so that
programs that pack modules find them.
"""

from __future__ import annotations

import os
import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

from solari_vk.base.budget import load_budget
from solari_vk.base.errors import SolariError, quoted

# Scenes are Any here, because the module of the class Scene imports this one.
Function = TypeVar("Function", bound=Callable[..., Any])


@dataclass(frozen=True)
class Reader:
    """What reads a format, the options of `load` that it takes, and a sentence on whom these options are for."""

    read: Callable[..., Any]
    options: tuple[str, ...]
    only: str


_READERS: dict[str, Reader] = {}
_WRITERS: dict[str, Callable[[Any, Path], None]] = {}


def reads(*suffixes: str, options: tuple[str, ...] = (), only: str = "") -> Callable[[Function], Function]:
    """Register a function `read(path, *, strict, **options)`, which returns a Scene, for files with these suffixes.

    options: the names of those options of `load`, besides `strict`, that it takes. only: the sentence that an error
    adds to "only ..." if a file of another format is given one of these options.
    """

    def register(function: Function) -> Function:
        _READERS.update(dict.fromkeys(suffixes, Reader(function, options, only)))
        return function

    return register


def writes(*suffixes: str) -> Callable[[Function], Function]:
    """Register a function `write(scene, path)` for files with these suffixes."""

    def register(function: Function) -> Function:
        _WRITERS.update(dict.fromkeys(suffixes, function))
        return function

    return register


_SPLATS = (".spz", ".splat", ".ksplat", ".sog")


@cache
def _import_formats() -> None:
    # Not by name: formats import the class Scene, whose module imports this one to read and write files.
    for module in pkgutil.iter_modules([str(Path(__file__).parent)]):
        import_module(f"{__package__}.{module.name}")


def readable_suffixes() -> tuple[str, ...]:
    """The suffixes of all files that can be read, with their dots."""
    _import_formats()
    # Whichever format a program imported first, lists are the same.
    return tuple(sorted(_READERS, key=lambda suffix: _READERS[suffix].read.__module__))


def read_file(
    path: str | os.PathLike[str],
    *,
    strict: bool = False,
    memory: int | None = None,
    seconds: float | None = None,
    **options: Any,
) -> Any:
    """The Scene of a file, as `load` returns it. Options that are None count as not given."""
    if not isinstance(path, str | os.PathLike):
        raise SolariError(f"load: the path of a file is needed, not {quoted(path)}")
    if str(path).startswith("builtin:"):
        name = str(path).removeprefix("builtin:")
        raise SolariError(f"{path}: is no file: write solari_vk.builtin({quoted(name)}) in its place")
    _import_formats()
    suffix = Path(path).suffix.lower()
    reader = _READERS.get(suffix)
    if reader is None:
        what = "compressed Gaussian splats" if suffix in _SPLATS else suffix or "a file without an ending"
        raise SolariError(f"{path}: {what} is not read: give a file of {', '.join(readable_suffixes())}")
    # An option that is left out has the reader's own default.
    chosen = {name: value for name, value in options.items() if value is not None}
    for other in _READERS.values():
        if chosen.keys() & set(other.options) - set(reader.options):
            raise SolariError(f"{path}: only {other.only}")
    # All of a file counts together, whatever reader it has.
    with load_budget(memory, seconds):
        return reader.read(path, strict=strict, **chosen)


def write_file(scene: Any, path: str | os.PathLike[str]) -> None:
    """Write a Scene, as `Scene.save` does."""
    if not isinstance(path, str | os.PathLike):
        raise SolariError(f"Scene.save: the path of a file is needed, not {quoted(path)}")
    _import_formats()
    target = Path(path)
    write = _WRITERS.get(target.suffix.lower())
    if write is None:
        endings = " or ".join(_WRITERS)
        raise SolariError(f"{target}: scenes are saved as {endings}: give a name with one of these endings")
    write(scene, target)
