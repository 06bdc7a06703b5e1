"""What the site shows that isn't written in docs/: the command line, docstrings, pages from the top of the repository,
and formulas as MathML. MkDocs calls the functions whose names begin with `on_`.
"""

from __future__ import annotations

import argparse
import html
import re
import runpy
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.structure.files import File, Files

from solari_vk import cli

ROOT = Path(__file__).resolve().parents[2]
AT_THE_TOP = ("CONTRIBUTING.md", "CHANGELOG.md")
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([\[(])(.*?)\\[\])]</\1>', re.DOTALL)
COMMANDS = "<!-- made from the code: commands -->"
DOCSTRINGS = re.compile(r"<!-- the site shows each in full\n(.*?)-->", re.DOTALL)
text_in_table = runpy.run_path(str(ROOT / "tools" / "reference.py"))["text_in_table"]


def on_files(files: Files, config: Any) -> Files:
    """Add the pages from the top of the repository."""
    for name in AT_THE_TOP:
        text = (ROOT / name).read_text(encoding="utf-8").replace("](docs/", "](")
        files.append(File.generated(config, name.lower(), content=text))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Fill in the command line, show docstrings, and lead links to the pages from the top."""
    for name in AT_THE_TOP:
        markdown = re.sub(rf"\]\(\.\./((?:\.\./)*){name}", rf"](\1{name.lower()}", markdown)
    return DOCSTRINGS.sub(r"\1", markdown.replace(COMMANDS, commands()))


def on_page_content(content: str, **_: Any) -> str:
    """Turn TeX between dollar signs into MathML, which browsers show without a script."""
    return FORMULA.sub(lambda formula: _mathml(html.unescape(formula[3]).strip(), formula[2] == "["), content)


def _mathml(tex: str, is_block: bool) -> str:
    made: str = convert(tex, display="block" if is_block else "inline")
    return f'<div class="formula">{made}</div>' if is_block else made


# ---- the command line -------------------------------------------------------------------------------


def commands() -> str:
    """Every command with its usage and a table of its options."""
    parts = []
    for name, command in _commands(cli._parser()).items():
        parts += _command(f"solari-vk {name}", command, 2)
    return "\n".join(parts)


def _commands(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """The commands of a parser by name."""
    actions = (action for action in parser._actions if isinstance(action, argparse._SubParsersAction))
    return {name: inner for action in actions for name, inner in action.choices.items()}


def _command(name: str, parser: argparse.ArgumentParser, level: int) -> list[str]:
    formatter = argparse.HelpFormatter(name, width=72)
    formatter.add_usage(parser.usage, parser._actions, parser._mutually_exclusive_groups)
    lines = [f"{'#' * level} {name}\n", f"{text_in_table(parser.description or '')}\n",
             f"```text\n{formatter.format_help().strip()}\n```\n"]  # fmt: skip
    options = [a for a in parser._actions if not isinstance(a, argparse._SubParsersAction | argparse._HelpAction)]
    if options:
        lines += ["| option | meaning |", "| --- | --- |"]
        lines += [f"| {_spelling(action)} | {text_in_table(action.help or '')} |" for action in options]
        lines.append("")
    for part, inner in _commands(parser).items():
        lines += _command(f"{name} {part}", inner, level + 1)
    return lines


def _spelling(action: argparse.Action) -> str:
    choices = "|".join(map(str, action.choices)) if action.choices else ""
    value = str(action.metavar or choices or action.dest)
    if action.option_strings:
        value = ", ".join(action.option_strings) + (f" {value}" if action.nargs != 0 else "")
    return f"`{value}`"
