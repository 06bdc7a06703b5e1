"""The notebooks of docs/notebooks run from top to bottom, and hold small outputs of an earlier run."""

from __future__ import annotations

import json
import re
import runpy

import numpy as np
import pytest
from test_pages import DOCS, ROOT

NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))
SMALLER = {r"\(320, 180\)": "(32, 18)", "160x120": "32x24", r"range\(24\)": "range(2)", r"--views \d+": "--views 3"}
run = runpy.run_path(str(ROOT / "tools" / "notebooks.py"))["run"]


def small(source):
    for shown, smaller in SMALLER.items():
        source = re.sub(shown, smaller, source)
    return source


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_runs(any_device, path, tmp_path):
    notebook = json.loads(path.read_text())
    names = run(notebook, tmp_path, small)
    shown = [output for cell in notebook["cells"] for output in cell.get("outputs", [])]
    assert any("image/jpeg" in output.get("data", {}) for output in shown)
    if path.stem == "first_picture":
        assert names["ball_pixels"].any()
        assert (tmp_path / "picture.exr").stat().st_size > 0
    elif path.stem == "data_set":
        assert names["status"] == 0
        assert len(names["views"]) == 3
    else:
        assert np.isfinite(names["distances"]).any()


def test_what_is_stored_is_small_and_complete():
    assert len(NOTEBOOKS) == 3
    for path in NOTEBOOKS:
        assert path.stat().st_size < 100_000, path
        cells = [cell for cell in json.loads(path.read_text())["cells"] if cell["cell_type"] == "code"]
        assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1)), path
        assert any("image/jpeg" in output.get("data", {}) for cell in cells for output in cell["outputs"]), path
