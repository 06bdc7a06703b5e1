"""Runs the notebooks of docs/notebooks, and stores their outputs in them: pictures as small JPEGs, and what is printed.

    python tools/notebooks.py [NAME ...]

It needs no Jupyter: the cells run one after another in a temporary folder, as a kernel would run them.
"""

from __future__ import annotations

import ast
import base64
import contextlib
import io
import json
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from PIL import Image

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "notebooks"


def run(notebook: dict[str, Any], folder: str | Path, change: Callable[[str], str] = str) -> dict[str, Any]:
    """Run the cells in a folder and store their outputs; returns the names that they define."""
    names: dict[str, Any] = {"__name__": "__main__"}
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    with contextlib.chdir(folder):
        for number, cell in enumerate(cells, 1):
            printed = io.StringIO()
            with contextlib.redirect_stdout(printed):
                shown = _run_cell(change("".join(cell["source"])), names)
            cell["execution_count"] = number
            cell["outputs"] = [*_text(printed.getvalue()), *_shown(shown, number)]
    return names


def _run_cell(source: str, names: dict[str, Any]) -> Any:
    """Run a cell; returns the value of its last line, if that is an expression."""
    program = ast.parse(source)
    last = program.body.pop() if isinstance(program.body[-1], ast.Expr) else None
    exec(compile(program, "cell", "exec"), names)
    if last is None:
        return None
    return eval(compile(ast.Expression(last.value), "cell", "eval"), names)


def _text(printed: str) -> list[dict[str, Any]]:
    return [{"output_type": "stream", "name": "stdout", "text": printed}] if printed else []


def _shown(value: Any, number: int) -> list[dict[str, Any]]:
    """The output of a cell's last value: a picture if it can be shown as one, or its text."""
    if value is None:
        return []
    data = {"text/plain": repr(value)}
    if hasattr(value, "_repr_png_"):
        small = io.BytesIO()
        Image.open(io.BytesIO(value._repr_png_())).convert("RGB").save(small, "JPEG", quality=85)
        data = {"image/jpeg": base64.b64encode(small.getvalue()).decode(), "text/plain": "a picture"}
    return [{"output_type": "execute_result", "execution_count": number, "data": data, "metadata": {}}]


if __name__ == "__main__":
    for path in [FOLDER / f"{name}.ipynb" for name in sys.argv[1:]] or sorted(FOLDER.glob("*.ipynb")):
        content = json.loads(path.read_text(encoding="utf-8"))
        with tempfile.TemporaryDirectory() as scratch:
            run(content, scratch)
        path.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        print(path.name, f"{path.stat().st_size / 1000:.0f} kB")
