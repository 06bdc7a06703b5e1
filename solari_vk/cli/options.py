"""Words of a command line become typed jobs here: only this module knows argparse.

A job is a frozen dataclass whose fields are the options of its command, with their defaults. The help lists them in the
order of the fields, and those in its `GROUPS` below their titles, after the others.
"""

from __future__ import annotations

import argparse
import math
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import MISSING, dataclass, field, fields
from importlib import import_module
from typing import Any, NoReturn

from solari_vk import __version__
from solari_vk.base.errors import brief, quoted, unknown_name

ON_OR_OFF = argparse.BooleanOptionalAction


def option(
    meaning: str, metavar: str | None = None, *, names: Sequence[str] = (), listing: str = "", **how: Any
) -> Any:
    """A field of a job. how: `default`, and what argparse's add_argument takes; a `bool` is a flag.

    listing: the MODULE:NAME, below solari_vk, of the choices that the help names in place of `%(listing)s`.
    """
    default = how.pop("default", MISSING if names or how.get("required") else None)
    if metavar is not None:
        how["metavar"] = metavar
    return field(default=default, metadata={"names": names, "listing": listing, "how": {"help": meaning, **how}})


def flag(meaning: str, *, listing: str = "") -> Any:
    """A field of a job that is true if the option is given. listing: as of `option`."""
    return option(meaning, default=False, action="store_true", listing=listing)


def resolve(place: str) -> Any:
    """What MODULE:NAME, below solari_vk, means."""
    module, _, name = place.partition(":")
    return getattr(import_module(f"solari_vk.{module}"), name)


@dataclass(frozen=True)
class _Listing:
    """Choices in words, for a help text, such as "red, green or blue".

    They are looked up when the help is shown, so that commands which run don't import them for their parser.
    """

    place: str

    def __str__(self) -> str:
        found = resolve(self.place)
        names = list(found() if callable(found) else found)
        return f"{', '.join(names[:-1])} or {names[-1]}"


@dataclass(frozen=True)
class Command:
    """A command: its name, the function that does it, and its job, each as MODULE:NAME below solari_vk.

    A job may have a DESCRIPTION, and PARTS: commands below this one, each of which may stand behind its name; without
    `does` one of them must. FIRST of a job: the options that the short help has, where `--help all` has the rest.
    examples: command lines, which the help begins with. hidden: the help of all commands doesn't list it.
    """

    name: str
    meaning: str
    does: str
    job: str | type[Any]
    aliases: tuple[str, ...] = ()
    examples: tuple[str, ...] = ()
    hidden: bool = False

    @property
    def job_type(self) -> type[Any]:
        """The job's class, whose module is imported when it is first asked for."""
        found: type[Any] = resolve(self.job) if isinstance(self.job, str) else self.job
        return found

    @property
    def description(self) -> str | None:
        """What the help of the command says first. It isn't inherited: a part's job may derive from its command's."""
        found: str | None = vars(self.job_type).get("DESCRIPTION")
        return found

    @property
    def parts(self) -> tuple[Command, ...]:
        """The commands below this one."""
        found: tuple[Command, ...] = vars(self.job_type).get("PARTS", ())
        return found

    def run(self, job: Any) -> int:
        """Do a job; returns the exit code. What is checked before anything large is imported is its `check`."""
        if hasattr(job, "check"):
            job.check()
        return resolve(self.does)(job) or 0


_WRONG_COMMAND = re.compile(r"argument (COMMAND|PART): invalid choice: '(.*)' \(choose from .*\)")  # argparse's words


class _Help(argparse._HelpAction):
    """--help, or --help all."""

    def __init__(self, option_strings: Sequence[str]) -> None:
        super().__init__(option_strings, help="show this, or with the word all every option")
        self.nargs = "?"
        self.metavar = "all"
        self.choices = ("all",)

    def __call__(self, parser: Any, namespace: Any, values: Any, option_string: str | None = None) -> None:
        parser._print_message(parser.format_help() if values == "all" else parser.short_help(), sys.stdout)
        parser.exit()


class _Parser(argparse.ArgumentParser):
    """A parser, also of the commands below, whose errors don't repeat endless words. examples, first: see `Command`."""

    examples: tuple[str, ...] = ()
    first: tuple[str, ...] = ()

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        # As in Python 3.14: -33.9,151.2 is a value too, no option.
        self._negative_number_matcher = re.compile(r"-\.?\d")

    def format_help(self) -> str:
        lines = "".join(f"  {example}\n" for example in self.examples)
        return (f"examples:\n{lines}\n" if lines else "") + super().format_help()

    def short_help(self) -> str:
        """The help with the options that people use first."""
        rest = [one for one in self._actions if one.option_strings and one.dest not in self.first]
        rest = [one for one in rest if not isinstance(one, _Help)]
        texts = [one.help for one in rest]
        for one in rest:
            one.help = argparse.SUPPRESS
        text = self.format_help()
        for one, help_text in zip(rest, texts, strict=True):
            one.help = help_text
        return f"{text}\n{len(rest)} more options: {self.prog} --help all\n"

    def error(self, message: str) -> NoReturn:
        wrong = _WRONG_COMMAND.fullmatch(message)
        if wrong:
            # argparse lists all names; `unknown_name` says which one was meant.
            kind, word = wrong.groups()
            message = str(unknown_name(f"there is no {kind.lower()}", word, shown_parts(self)))
        super().error(brief(message))

    def _get_values(self, action: argparse.Action, arg_strings: list[str]) -> Any:
        # argparse takes --option=-- for an option without a value, and fails later without a message.
        if arg_strings == ["--"] and action.option_strings:
            raise argparse.ArgumentError(action, "-- is no value: write ./-- for a file of this name")
        return super()._get_values(action, arg_strings)


def make_parser(commands: Sequence[Command], wanted: str | None = None) -> argparse.ArgumentParser:
    """The parser of all commands. Its result holds only what is given: jobs have the defaults.

    wanted: the only command whose options are needed, so that the modules of the others aren't imported.
    """
    parser = _Parser(prog="solari-vk", description="Raytraced lighting on any Vulkan device that traces rays.")
    parser.examples = (
        "solari-vk render model.glb -o picture.png",
        "solari-vk view model.glb",
        "solari-vk render --help",
    )
    parser.add_argument("--version", action="version", version=f"solari_vk {__version__}")
    _add_commands(parser.add_subparsers(required=True, metavar="COMMAND"), commands, wanted)
    return parser


def parse(commands: Sequence[Command], words: Sequence[str] | None) -> tuple[Command, Any]:
    """The command that words ask for, and its job. Wrong usage ends the process with exit code 2."""
    if words is None:
        words = sys.argv[1:]
    words = _with_help_as_option(commands, words)
    # Before a command there are only options of this program, such as --version.
    wanted = next((word for word in words if not word.startswith("-")), "")
    parser = make_parser(commands, wanted)
    parsed, unknown = parser.parse_known_args(words)
    values = vars(parsed)
    command: Command = values.pop("command")
    if unknown:
        parser.error(_why_unknown(command, unknown))
    arguments = {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
    # A job with this field tells options that the user gave from those that have their defaults.
    if "explicit" in command.job_type.__dataclass_fields__:
        arguments["explicit"] = frozenset(values)
    return command, command.job_type(**arguments)


def _with_help_as_option(commands: Sequence[Command], words: Sequence[str]) -> Sequence[str]:
    """`help WORDS` as `WORDS --help`, also behind a command that only has others below it."""
    words = list(words)
    at = 1 if any(words[:1] == [one.name] and not one.does for one in commands) else 0
    if words[at : at + 1] != ["help"]:
        return words
    named = [*words[:at], *words[at + 1 :]]
    every = named[-1:] if named[-1:] == ["all"] else []
    return [*named[: len(named) - len(every)], "--help", *every]


def _why_unknown(command: Command, words: Sequence[str]) -> str:
    """The message for words that a command doesn't take."""
    option = next((word for word in words if word.startswith("-")), "")
    if not option:
        return f"{command.name} takes no {', '.join(map(quoted, words))}"
    known: list[str] = []
    for part in fields(command.job_type):
        if part.metadata:
            known += part.metadata["names"] or [spelled(part.name)]
    return str(unknown_name(f"{command.name} has no option", option.partition("=")[0], known))


def _add_commands(place: Any, commands: Sequence[Command], wanted: str | None) -> None:
    for command in commands:
        shown = {} if command.hidden else {"help": command.meaning}  # without this word it isn't listed
        if wanted is not None and wanted not in (command.name, *command.aliases):
            # The list of commands shows its name, and argparse doesn't ask for its options.
            place.add_parser(command.name, aliases=command.aliases, **shown)
            continue
        job = command.job_type
        parser = place.add_parser(
            command.name,
            description=command.description,
            aliases=command.aliases,
            argument_default=argparse.SUPPRESS,
            add_help=not hasattr(job, "FIRST"),
            **shown,
        )
        parser.examples = command.examples
        if hasattr(job, "FIRST"):
            parser.first = job.FIRST
            parser._add_action(_Help(("-h", "--help")))
        # The innermost command wins: argparse sets the defaults of a command before those of its part.
        parser.set_defaults(command=command)
        _add_options(parser, job)
        if command.parts:
            parts = parser.add_subparsers(metavar="PART", required=not command.does)
            _add_commands(parts, command.parts, None)


def shown_parts(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """The commands of a parser by name, but hidden ones and other names of one."""
    found: dict[str, argparse.ArgumentParser] = {}
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            found |= {one.dest: action.choices[one.dest] for one in action._choices_actions}
    return found


def _add_options(parser: argparse.ArgumentParser, job: type[Any]) -> None:
    options = {part.name: part.metadata for part in fields(job) if part.metadata}
    groups: dict[str, tuple[str, ...]] = getattr(job, "GROUPS", {})
    grouped = {name for names in groups.values() for name in names}
    ungrouped = tuple(name for name in options if name not in grouped)
    for title, names in (("", ungrouped), *groups.items()):
        place = parser.add_argument_group(title) if title else parser
        for name in names:
            action = place.add_argument(*(options[name]["names"] or [spelled(name)]), **options[name]["how"])
            # argparse fills `%(listing)s` in a help text with the attribute of this name.
            vars(action)["listing"] = _Listing(options[name]["listing"])


@dataclass(frozen=True)
class Word:
    """An option: its names, the choices for its value, and whether it has a value."""

    names: tuple[str, ...]
    choices: tuple[str, ...]
    has_value: bool


@dataclass(frozen=True)
class Outline:
    """The words that a command takes. path: those that lead to it. parts: the meanings of the commands below it."""

    path: tuple[str, ...]
    parts: dict[str, str]
    options: tuple[Word, ...]
    choices: tuple[str, ...]
    """Of its arguments without names."""


def outlines(commands: Sequence[Command]) -> list[Outline]:
    """What completion needs of all commands that aren't hidden, the program's own first."""
    return _outlines(make_parser(commands), ())


def _outlines(parser: argparse.ArgumentParser, path: tuple[str, ...]) -> list[Outline]:
    parts: dict[str, str] = {}
    options = []
    choices: list[str] = []
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            parts |= {one.dest: one.help or "" for one in action._choices_actions}
        elif action.option_strings:
            values = tuple(map(str, action.choices or ()))
            options.append(Word(tuple(action.option_strings), values, action.nargs != 0))
        else:
            choices += map(str, action.choices or ())
    found = [Outline(path, parts, tuple(options), tuple(choices))]
    for name, part in shown_parts(parser).items():
        found += _outlines(part, (*path, name))
    return found


def spelled(name: str) -> str:
    """The option of a job's field."""
    return f"--{name.replace('_', '-')}"


# ---- types of values --------------------------------------------------------------------------------


def size(text: str) -> tuple[int, int]:
    """Width and height from a text such as 640x360."""
    try:
        width, height = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{quoted(text)} is not a size: give one such as 640x360") from None
    if not (1 <= width <= 16384 and 1 <= height <= 16384):
        # Most Vulkan devices have no images with more pixels on a side.
        raise argparse.ArgumentTypeError("a size must be from 1x1 to 16384x16384 pixels")
    return width, height


def one_of(what: str, place: str) -> Callable[[str], str]:
    """The type of one of the names at MODULE:NAME, below solari_vk. what: what a name stands for, for errors."""

    def check(name: str) -> str:
        names = resolve(place)
        if name not in names:
            raise argparse.ArgumentTypeError(str(unknown_name(f"there is no {what}", name, names)))
        return name

    return check


def words(text: str) -> tuple[str, ...]:
    """The names in a list with commas."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def positive(text: str) -> int:
    """A whole number of at least 1."""
    return _integer(text, 1)


def count(text: str) -> int:
    """A whole number of at least 0."""
    return _integer(text, 0)


def _integer(text: str, minimum: int) -> int:
    try:
        number = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{quoted(text)} is not a whole number") from None
    if number < minimum:
        raise argparse.ArgumentTypeError(f"must be at least {minimum}, not {number}")
    return number


def number(text: str) -> float:
    """A finite number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{quoted(text)} is not a number")
    return value


def seconds(text: str) -> tuple[float, float]:
    """One or two numbers of seconds, with a comma between them, the second 0 by default."""
    parts = [factor(part) for part in text.split(",")]
    if len(parts) > 2:
        raise argparse.ArgumentTypeError(f"{quoted(text)} is not SECONDS or SECONDS,READOUT")
    return parts[0], parts[1] if len(parts) == 2 else 0.0


def place(text: str) -> tuple[float, float]:
    """Latitude and longitude from a text such as 52.5,13.4."""
    latitude, comma, longitude = text.partition(",")
    if not comma:
        raise argparse.ArgumentTypeError(f"{quoted(text)} is not LAT,LON: give such as 52.5,13.4 or -33.9,151.2")
    return number(latitude), number(longitude)


def factor(text: str) -> float:
    """A finite number that isn't negative."""
    value = number(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"must not be negative, as {text} is")
    return value
