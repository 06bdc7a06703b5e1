"""`solari-vk completion`: scripts that complete words in shells, made from the commands and their options."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from solari_vk.cli.options import Command, Outline, option, outlines

SHELLS = ("bash", "zsh", "fish")


@dataclass(frozen=True, kw_only=True)
class CompletionJob:
    """A script for a shell."""

    DESCRIPTION: ClassVar = "Print a script that completes commands, options and their choices in a shell."

    shell: str = option("the shell", names=("shell",), choices=SHELLS)


def run(job: CompletionJob) -> None:
    """Print the script."""
    from solari_vk.cli.commands import COMMANDS

    print(script(COMMANDS, job.shell))


def script(commands: Sequence[Command], shell: str) -> str:
    """The script of one of SHELLS."""
    found = outlines(commands)
    if shell == "fish":
        return "\n".join(line for outline in found for line in _fish(outline))
    text = "\n".join(_bash(found, _other_names(commands, found)))
    # zsh runs completions of bash.
    return f"autoload -U +X bashcompinit && bashcompinit\n{text}" if shell == "zsh" else text


def _other_names(commands: Sequence[Command], found: Sequence[Outline]) -> dict[str, str]:
    """The places of commands by their names that aren't listed: aliases, and those of hidden commands."""
    names = {alias: command.name for command in commands for alias in command.aliases}
    hidden = [command.name for command in commands if command.hidden]
    return names | {one.path[-1]: " ".join(one.path) for one in found if len(one.path) == 2 and one.path[1] in hidden}


def _bash(found: Sequence[Outline], others: Mapping[str, str]) -> list[str]:
    steps: list[str] = []
    words: list[str] = []
    options: list[str] = []
    values: list[str] = []
    for outline in found:
        place = " ".join(outline.path)
        if place:
            steps.append(f'"{place}"')
        words.append(f'        "{place}") words="{" ".join((*outline.parts, *outline.choices))}" ;;')
        names = (name for word in outline.options for name in word.names)
        options.append(f'        "{place}") words="{" ".join(names)}" ;;')
        for word in outline.options:
            if word.choices:
                cases = "|".join(f'"{place} {name}"' for name in word.names)
                values.append(f'        {cases}) words="{" ".join(word.choices)}" ;;')
    return [
        "_solari_vk() {",
        '    local word="${COMP_WORDS[COMP_CWORD]}" before="${COMP_WORDS[COMP_CWORD-1]}" place="" words="" i',
        "    for ((i = 1; i < COMP_CWORD; i++)); do",
        '        case "${place:+$place }${COMP_WORDS[i]}" in',
        *(f'            "{name}") place="{meant}" ;;' for name, meant in others.items()),
        f'            {"|".join(steps)}) place="${{place:+$place }}${{COMP_WORDS[i]}}" ;;',
        "        esac",
        "    done",
        '    case "$place" in',
        *words,
        "    esac",
        '    [[ "$word" == -* ]] && case "$place" in',
        *options,
        "    esac",
        '    case "$place $before" in',
        *values,
        "    esac",
        '    COMPREPLY=($(compgen -W "$words" -- "$word"))',
        "}",
        "complete -o default -F _solari_vk solari-vk",  # files, where no word fits
    ]


def _fish(outline: Outline) -> Iterator[str]:
    seen = "; and ".join(f"__fish_seen_subcommand_from {word}" for word in outline.path) or "__fish_use_subcommand"
    begin = f"complete -c solari-vk -n {shlex.quote(seen)}"
    for name, meaning in outline.parts.items():
        yield f"{begin} -f -a {name} -d {shlex.quote(meaning)}"
    if outline.choices:
        yield f"{begin} -f -a {shlex.quote(' '.join(outline.choices))}"
    for word in outline.options:
        names = " ".join(f"-l {name[2:]}" if name.startswith("--") else f"-s {name[1:]}" for name in word.names)
        value = " -r" if word.has_value else ""
        if word.choices:
            value = f" -x -a {shlex.quote(' '.join(word.choices))}"
        yield f"{begin} {names}{value}"
