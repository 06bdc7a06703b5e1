"""What the site shows that isn't written in docs/: tables made from the code, pages from the top of the repository, and
formulas as MathML. MkDocs calls the functions whose names begin with `on_`.
"""

from __future__ import annotations

import argparse
import html
import re
from itertools import groupby
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.structure.files import File, Files

from solari_vk import cli
from solari_vk.passes.debug_views import DEBUG_VIEWS
from solari_vk.settings import DEFAULTS, FIELDS, QUALITIES, allowed

ROOT = Path(__file__).resolve().parents[2]
AT_THE_TOP = ("CONTRIBUTING.md", "CHANGELOG.md")
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([\[(])(.*?)\\[\])]</\1>', re.DOTALL)
PLACE = re.compile(r"<!-- made from the code: (\w+) -->")


def on_files(files: Files, config: Any) -> Files:
    """Add the pages from the top of the repository."""
    for name in AT_THE_TOP:
        text = (ROOT / name).read_text(encoding="utf-8").replace("](docs/", "](")
        files.append(File.generated(config, name.lower(), content=text))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Fill in what is made from the code, and lead links to the pages from the top."""
    for name in AT_THE_TOP:
        markdown = re.sub(rf"\]\(\.\./((?:\.\./)*){name}", rf"](\1{name.lower()}", markdown)
    return PLACE.sub(lambda place: MADE[place[1]](), markdown)


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
    lines = [f"{'#' * level} {name}\n", f"{_text(parser.description or '')}\n",
             f"```text\n{formatter.format_help().strip()}\n```\n"]  # fmt: skip
    options = [a for a in parser._actions if not isinstance(a, argparse._SubParsersAction | argparse._HelpAction)]
    if options:
        lines += ["| option | meaning |", "| --- | --- |"]
        lines += [f"| {_spelling(action)} | {_text(action.help or '')} |" for action in options]
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


def _text(text: str) -> str:
    """Words of the code in a table: only what stands between backquotes is code."""
    parts = re.split(r"(`[^`]*`)", text.replace("%%", "%"))
    return "".join(part if part.startswith("`") else re.sub(r"[|<>*_{}]", _entity, part) for part in parts)


def _entity(character: re.Match[str]) -> str:
    return f"&#{ord(character[0])};"


# ---- settings and views -----------------------------------------------------------------------------


def settings() -> str:
    """All settings by section, and the presets."""
    parts = []
    for section, names in groupby(FIELDS, key=lambda name: FIELDS[name].section):
        parts += [f"## {section}\n", "| setting | default | allowed | meaning |", "| --- | --- | --- | --- |"]
        for name in names:
            parts.append(f"| `{name}` | {DEFAULTS[name]} | {_text(allowed(name))} | {_text(FIELDS[name].meaning)} |")
        parts.append("")
    parts += ["## Presets\n", "`sv.Settings.preset(name)` and `--quality name`.\n", "| name | what it changes |",
              "| --- | --- |"]  # fmt: skip
    for name, values in QUALITIES.items():
        changes = ", ".join(f"`{key}={value}`" for key, value in values.items())
        parts.append(f"| `{name}` | {changes or 'nothing: the defaults'} |")
    return "\n".join(parts)


def views() -> str:
    """All debug views."""
    rows = [f"| `{name}` | {_text(meaning)} |" for name, meaning in DEBUG_VIEWS.items()]
    return "\n".join(["| name | what it shows |", "| --- | --- |", *rows])


MADE = {"commands": commands, "settings": settings, "views": views}
