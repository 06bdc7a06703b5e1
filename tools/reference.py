"""Writes into the pages of docs what is made from the code, so that they can be read without building the site.

    python tools/reference.py

Each page keeps its own text. Between `<!-- made from the code: WHAT -->` and `<!-- end -->` stands what the function
WHAT of MADE gives: lists of the names that the site shows in full, all settings, debug views and outputs at pixels'
centers. A function that makes several parts is told which one: `<!-- made from the code: calls Mitsuba -->`.
"""

from __future__ import annotations

import argparse
import importlib
import inspect
import re
import tomllib
from enum import Enum
from itertools import groupby
from pathlib import Path
from typing import Any

from solari_vk import cli
from solari_vk.base.errors import OTHER_WORDS, other_words
from solari_vk.cli.options import shown_parts
from solari_vk.passes.debug_views import DEBUG_VIEWS
from solari_vk.passes.first_hits import FIRST_HITS, GEOMETRY
from solari_vk.settings import DEFAULTS, FIELDS, QUALITIES, allowed

PAGES = Path(__file__).resolve().parents[1] / "docs"
PLACE = re.compile(r"(<!-- made from the code: (\w+)(?: ([^\n]+))? -->\n)(.*?)(<!-- end -->)", re.DOTALL)
NAMED = re.compile(
    r"^::: ([\w.]+)\n(?:    options:\n(?:      (?!members).*\n)*(?:      members: \[(.*)\]\n)?)?", re.MULTILINE
)
COMMON = {"describe", "update", "watch", "unwatch"}  # of every object of a scene


def text_in_table(text: str) -> str:
    """Words of the code in a table: only what stands between backquotes is code."""
    parts = re.split(r"(`[^`]*`)", text)
    return "".join(part if part.startswith("`") else re.sub(r"[|<>*_{}]", _entity, part) for part in parts)


def _entity(character: re.Match[str]) -> str:
    return f"&#{ord(character[0])};"


def names(page: str) -> str:
    """What the page's lines `::: NAME` stand for: the names with their arguments, first sentences, and methods."""
    lines = []
    for name, members in NAMED.findall(page):
        found = _object(name)
        if inspect.ismodule(found):
            shown = members.split(", ") if members else _public(found)
            lines += [_line(getattr(found, each), each, "") for each in shown]
        else:
            lines.append(_line(found, name.rpartition(".")[2], members))
    return "\n".join(lines) + "\n"


def _line(found: Any, name: str, members: str) -> str:
    sentence = re.split(r"(?<=\.)\s", inspect.cleandoc(found.__doc__ or ""), maxsplit=1)[0].partition("\n\n")[0]
    line = f"- **`{name}({', '.join(_arguments(found))})`** {' '.join(sentence.split())}"
    if inspect.isclass(found):
        methods = members.split(", ") if members else _methods(found)
        if methods:
            line += f" Has {', '.join(f'`{each}`' for each in methods)}."
    return line


def _arguments(found: Any) -> list[str]:
    """The names of the arguments of a function or class, and those of which it makes others; none of enumerations."""
    if inspect.isclass(found) and issubclass(found, Exception | Enum):
        return []
    # As they are written, so that *args and **options keep their signs.
    names = [str(each).partition(":")[0].partition("=")[0] for each in inspect.signature(found).parameters.values()]
    return [*names, *(name for name in getattr(found, "_derived", ()) if name not in names)]


def _object(name: str) -> Any:
    """What a dotted name means."""
    # The longest part of the name that is a module; what is left are attributes.
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        for part in parts[count:]:
            found = getattr(found, part)
        return found
    raise ValueError(name)


def _public(module: Any) -> list[str]:
    """The functions and classes that a module defines, or those that it says it offers, in their order."""
    offered = getattr(module, "__all__", None)
    if offered:
        return [name for name in offered if callable(getattr(module, name))]
    return [
        name
        for name, value in vars(module).items()
        if not name.startswith("_") and getattr(value, "__module__", "") == module.__name__
    ]


def _methods(found: type) -> list[str]:
    """The public methods and properties of a class of the package, those of its bases first."""
    own = {
        name: None
        for base in reversed(found.__mro__)
        if base.__module__.startswith("solari_vk")
        for name, value in vars(base).items()
        if not name.startswith("_") and _is_method(value)
    }
    return [name for name in own if name not in COMMON]


def _is_method(value: Any) -> bool:
    # Functions and properties bind to objects, and so do the descriptors of slots, which are plain fields.
    return not inspect.isclass(value) and (hasattr(value, "__get__") and not inspect.ismemberdescriptor(value))


def settings(page: str) -> str:
    """All settings by section, and the presets."""
    parts = []
    for section, fields in groupby(FIELDS, key=lambda name: FIELDS[name].section):
        parts += [f"## {section}\n", "| setting | default | allowed | meaning |", "| --- | --- | --- | --- |"]
        for name in fields:
            meaning = text_in_table(FIELDS[name].meaning)
            parts.append(f"| `{name}` | {DEFAULTS[name]} | {text_in_table(allowed(name))} | {meaning} |")
        parts.append("")
    parts += [
        "## Presets\n",
        "`sv.Settings.preset(name)` and `--quality name`.\n",
        "| name | what it changes |",
        "| --- | --- |",
    ]
    for name, values in QUALITIES.items():
        changes = ", ".join(f"`{key}={value}`" for key, value in values.items())
        parts.append(f"| `{name}` | {changes or 'nothing: the defaults'} |")
    return "\n".join(parts) + "\n"


def views(page: str) -> str:
    """All debug views."""
    rows = [f"| `{name}` | {text_in_table(meaning)} |" for name, meaning in DEBUG_VIEWS.items()]
    return "\n".join(["| name | what it shows |", "| --- | --- |", *rows]) + "\n"


def outputs(_: str, part: str) -> str:
    """The outputs at pixels' centers: `frame`, each with its meaning, or `batch`, their names."""
    if part == "frame":
        head = ["| at pixels' centers | what |"]
        rows = [f"| `{name}` | {output.meaning} |" for name, output in FIRST_HITS.items()]
    else:
        head = ["| at pixels' centers, as of [a frame](outputs.md) | |"]
        of_materials = [name for name in FIRST_HITS if name not in GEOMETRY]
        kinds = {"of the geometry, by default": GEOMETRY, "of the material": of_materials}
        rows = [f"| {', '.join(f'`{name}`' for name in names)} | {meaning} |" for meaning, names in kinds.items()]
    return "\n".join([*head, "| --- | --- |", *rows]) + "\n"


def commands(_: str) -> str:
    """Every command with a table of what it takes."""
    return "\n".join(
        line
        for name, command in shown_parts(cli._parser()).items()
        for line in _command(f"solari-vk {name}", command, 2)
    )


def _command(name: str, parser: argparse.ArgumentParser, level: int) -> list[str]:
    lines = [f"{'#' * level} {name}\n", *([f"{text_in_table(parser.description)}\n"] if parser.description else [])]
    examples = getattr(parser, "examples", ())
    lines += ["```sh", *examples, "```\n"] if examples else []
    options = [a for a in parser._actions if not isinstance(a, argparse._SubParsersAction | argparse._HelpAction)]
    if options:
        lines += ["| option | meaning |", "| --- | --- |"]
        formatter = parser._get_formatter()  # which fills `%(listing)s` in
        lines += [f"| {_spelling(action)} | {text_in_table(formatter._expand_help(action))} |" for action in options]
        lines.append("")
    for part, inner in shown_parts(parser).items():
        lines += _command(f"{name} {part}", inner, level + 1)
    return lines


def _spelling(action: argparse.Action) -> str:
    choices = "\\|".join(map(str, action.choices)) if action.choices else ""
    value = str(action.metavar or choices or action.dest).replace("|", "\\|").replace("\\\\", "\\")
    if action.option_strings:
        value = ", ".join(action.option_strings) + (f" {value}" if action.nargs != 0 else "")
    return f"`{value}`"


def calls(_: str, program: str) -> str:
    """What one calls in another program, and what does it here."""
    rows = tomllib.loads(OTHER_WORDS.read_text(encoding="utf-8"))["programs"][program]
    return "\n".join(["| there | here |", "| --- | --- |", *(f"| {there} | {here} |" for there, here in rows)]) + "\n"


def advice(_: str) -> str:
    """The words of other programs that errors answer."""
    lines = ["| asked of | words | answer |", "| --- | --- | --- |"]
    for asked, answers in other_words().items():
        words_by_answer: dict[str, list[str]] = {}
        for word, answer in answers.items():
            words_by_answer.setdefault(answer, []).append(f"`{word}`")
        for answer, words in words_by_answer.items():
            lines.append(f"| `{asked}` | {', '.join(words)} | {text_in_table(answer)} |")
    return "\n".join(lines) + "\n"


MADE = {
    "names": names,
    "settings": settings,
    "views": views,
    "outputs": outputs,
    "commands": commands,
    "calls": calls,
    "advice": advice,
}


def filled(page: str) -> str:
    """A page's text with what is made from the code of today."""

    def fill(place: re.Match[str]) -> str:
        start, what, part, _, end = place.groups()
        made = MADE[what](page) if part is None else MADE[what](page, part)
        return f"{start}\n{made}\n{end}"

    return PLACE.sub(fill, page)


if __name__ == "__main__":
    for path in sorted(PAGES.rglob("*.md")):
        text = path.read_text(encoding="utf-8")
        if PLACE.search(text):
            path.write_text(filled(text), encoding="utf-8")
