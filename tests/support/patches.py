"""Shaders with some text replaced: seeded bugs of the tests, earlier behaviors that the claims compare with."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from solari_vk.errors import SolariError
from solari_vk.gpu.shaders import compiler

Patch = tuple[str, str, str]
"""A file below the GLSL root, text that the file holds exactly once, and the text that replaces it."""


def write_patched(folder: Path, *patches: Patch) -> Path:
    """Write the patched files, and only these, below `folder`, and return `folder`, a GLSL root for `glsl_root=`.

    Several patches of one file apply in their order. Raises SolariError when a file is missing or doesn't hold the text
    exactly once.
    """
    for file, old, new in patches:
        found = next((path for root in (folder, *compiler.roots()) if (path := root / file).is_file()), None)
        if found is None:
            raise SolariError(f"patch: there is no shader file {file}")
        text = found.read_text(encoding="utf-8")
        if text.count(old) != 1:
            raise SolariError(f"patch: {file} must hold this text exactly once, not {text.count(old)} times: {old!r}")
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).write_text(text.replace(old, new), encoding="utf-8")
    return folder


@contextmanager
def patched_shaders(*patches: Patch) -> Iterator[None]:
    """Compile all shaders with these patches as long as the context is open. Raises SolariError as `write_patched`."""
    with tempfile.TemporaryDirectory() as folder:
        compiler.overlays.insert(0, write_patched(Path(folder), *patches))
        try:
            yield
        finally:
            compiler.overlays.remove(Path(folder))
