"""What took long to render isn't lost when its file can't be written: it goes into a temporary folder."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from solari_vk.base.errors import SolariError, reworded
from solari_vk.base.files import make_temporary_folder


def write_with_fallback(path: Path, write: Callable[[Path], None]) -> None:
    """Write a picture by `write(path)`. Raises SolariError when that fails; it says where the picture is instead."""
    try:
        write(path)
    except SolariError as error:
        folder = _write_elsewhere(path.name, write)
        raise SolariError(f"{error}; the picture is in {folder}" if folder else str(error)) from None


def _write_elsewhere(name: str, write: Callable[[Path], None]) -> Path | None:
    """The temporary folder where a picture is now; None if it can't be written there either."""
    # It is often on another disk, where there is room when the first one is full.
    try:
        folder = make_temporary_folder()
    except SolariError:
        return None
    try:
        write(folder / name)
    except SolariError:
        shutil.rmtree(folder)
        return None
    return folder


@contextmanager
def frames_folder() -> Iterator[Path]:
    """A temporary folder for the pictures of a movie. A SolariError that ends the context says where they are."""
    folder = make_temporary_folder()
    has_pictures = False
    try:
        yield folder
    except SolariError as error:
        has_pictures = any(folder.iterdir())
        if not has_pictures:
            raise
        raise reworded(error, f"{error}; the pictures so far are in {folder}") from None
    finally:
        # After an error they stay, because they may have taken hours.
        if not has_pictures:
            shutil.rmtree(folder)
