"""What the site shows that isn't written in docs/: docstrings, pages from the top of the repository,
and formulas as MathML. MkDocs calls the functions whose names begin with `on_`.
"""

from __future__ import annotations

import html
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[2]
AT_THE_TOP = ("CONTRIBUTING.md", "CHANGELOG.md")
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([\[(])(.*?)\\[\])]</\1>', re.DOTALL)
DOCSTRINGS = re.compile(r"<!-- the site shows each in full\n(.*?)-->", re.DOTALL)


def on_files(files: Files, config: Any) -> Files:
    """Add the pages from the top of the repository."""
    for name in AT_THE_TOP:
        text = (ROOT / name).read_text(encoding="utf-8").replace("](docs/", "](")
        files.append(File.generated(config, name.lower(), content=text))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Show docstrings, and lead links to the pages from the top."""
    for name in AT_THE_TOP:
        markdown = re.sub(rf"\]\(\.\./((?:\.\./)*){name}", rf"](\1{name.lower()}", markdown)
    return DOCSTRINGS.sub(r"\1", markdown)


def on_page_content(content: str, **_: Any) -> str:
    """Turn TeX between dollar signs into MathML, which browsers show without a script."""
    return FORMULA.sub(lambda formula: _mathml(html.unescape(formula[3]).strip(), formula[2] == "["), content)


def _mathml(tex: str, is_block: bool) -> str:
    made: str = convert(tex, display="block" if is_block else "inline")
    return f'<div class="formula">{made}</div>' if is_block else made
