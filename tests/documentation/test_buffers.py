"""Docstrings of stages name their inputs and outputs, and the page of buffers is that of this code."""

from __future__ import annotations

import re
import runpy
from fnmatch import fnmatch
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BUFFERS = runpy.run_path(str(ROOT / "tools/buffers.py"))


@pytest.fixture(scope="module")
def frames(device):
    return list(BUFFERS["frames"](device))


@pytest.fixture(scope="module")
def accessed(frames):
    """{source of a stage: (inputs, outputs)} in all frames."""
    found = {}
    for stages, rows in frames:
        for source, *names in BUFFERS["inputs_and_outputs"](stages, rows):
            for known, new in zip(found.setdefault(source, (set(), set())), names, strict=True):
                known |= new
    return found


def differences(docstring, accessed):
    """What a docstring of a stage leaves out or names in vain."""
    for what, names in zip(("Inputs", "Outputs"), accessed, strict=True):
        text = re.search(rf"{what}: (.*?)(?:Outputs:|\Z)", docstring, re.DOTALL)
        patterns = re.findall(r"`(\S+)`", text[1]) if text else []
        yield from (f"{what} lack {name}" for name in sorted(names) if not any(fnmatch(name, p) for p in patterns))
        yield from (f"{what} name {p} in vain" for p in patterns if not any(fnmatch(name, p) for name in names))


def test_docstrings_of_stages_name_inputs_and_outputs(accessed):
    assert len(accessed) == 19
    wrong = {f"{source.file}: {source.docstring[:40]}": list(differences(source.docstring, names))
             for source, names in accessed.items()}  # fmt: skip
    assert not {stage: found for stage, found in wrong.items() if found}


def test_a_missing_and_a_superfluous_name_are_noticed():
    found = list(differences("Inputs: `a*`, `c`. Outputs: `d`.", ({"a1", "b"}, {"d"})))
    assert found == ["Inputs lack b", "Inputs name c in vain"]


def test_the_page_of_buffers_is_current(frames):
    page = (ROOT / "docs/explained/buffers.md").read_text(encoding="utf-8")
    assert page == BUFFERS["page"](frames), "run python tools/buffers.py > docs/explained/buffers.md"
