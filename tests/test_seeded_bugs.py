"""Every seeded bug of the suite still fits its shader, those of slow tests too."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.seeded_bugs import KNOWN, ROOTS

TESTS = Path(__file__).parent
GLSL = TESTS.parent / "glsl"
SHADERS = {path.relative_to(GLSL).as_posix(): path for path in GLSL.rglob("*") if path.suffix != ".spv"}
FILES = [path for path in sorted(TESTS.rglob("test_*.py")) if "patched" in path.read_text(encoding="utf-8")
         or "seeded_bugs" in path.read_text(encoding="utf-8")]  # fmt: skip


def find_shader(name: str) -> Path | None:
    """The shader of this path, or the only one whose path ends with it."""
    ends = [path for known, path in SHADERS.items() if known == name or known.endswith(f"/{name}")]
    return SHADERS.get(name, ends[0] if len(ends) == 1 else None)


def find_patches(value: Any) -> Iterator[tuple[Path, str]]:
    """Shaders, and the texts that are replaced in them, anywhere in a table of bugs."""
    if isinstance(value, dict):
        value = tuple(value.values())
    if not isinstance(value, tuple | list):
        return
    for at, item in enumerate(value):
        yield from find_patches(item)
        if isinstance(item, str) and len(value) > at + 2 and isinstance(value[at + 1], str):
            shader = find_shader(item) if "." in item else None
            if shader is not None and find_shader(value[at + 1]) is None:
                yield shader, value[at + 1]


def load(path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The module of a file of tests, without a name of its own, since pytest may import it too."""
    monkeypatch.syspath_prepend(str(path.parent))
    spec = importlib.util.spec_from_file_location(f"patches_of_{path.stem}", path)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)
    spec.loader.exec_module(module)
    return module


def test_patches_fit(monkeypatch):
    count, wrong = 0, []
    for path in FILES:
        tables = [value for name, value in vars(load(path, monkeypatch)).items() if name.isupper()]
        for table in tables:
            for shader, text in find_patches(table):
                count += 1
                found = shader.read_text(encoding="utf-8").count(text)
                if found != 1:
                    wrong.append(f"{path.name}: {shader.name} holds this text {found} times: {text!r}")
    assert count > 100, "the tables of seeded bugs were not found"
    assert not wrong, "\n".join(wrong)


def test_bugs_fit(monkeypatch):
    """Each bug that is anchored to a function or constant has exactly one of its name in its shader."""
    for path in FILES:
        load(path, monkeypatch)
    wrong = []
    for bug in KNOWN:
        try:
            bug.apply(next(path for root in ROOTS if (path := root / bug.file).is_file()).read_text(encoding="utf-8"))
        except ValueError as error:
            wrong.append(str(error))
    assert len(KNOWN) > 90, "the seeded bugs were not found"
    assert not wrong, "\n".join(wrong)
