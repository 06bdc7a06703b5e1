"""What the help shows first, the commands for developers, and the completion of words in shells."""

from __future__ import annotations

import io
import re
import shlex
import subprocess
import sys

import pytest

from solari_vk import cli
from solari_vk.cli import info
from solari_vk.cli.commands import COMMANDS, LAB
from solari_vk.cli.completion import SHELLS
from solari_vk.cli.options import parse

PEOPLE = [command for command in COMMANDS if not command.hidden]


def shown(capsys, *words):
    with pytest.raises(SystemExit) as ended:
        cli.main(words)
    assert ended.value.code == 0
    return capsys.readouterr().out


def test_commands_of_developers_are_behind_lab(capsys):
    text = shown(capsys, "--help")
    for name in ("trial", "fidelity", "conformance", "bench"):
        assert not re.search(rf"^    {name} ", text, re.MULTILINE)
        assert name in shown(capsys, "lab", "--help")
        # The former names go on.
        assert shown(capsys, name, "--help").splitlines()[3:9]
    words = ["model.glb", "-o", "folder"]
    assert parse(COMMANDS, ["lab", "trial", *words])[1] == parse(COMMANDS, ["trial", *words])[1]


@pytest.mark.parametrize("command", [*PEOPLE, *LAB], ids=lambda command: command.name)
def test_help_begins_with_examples_that_parse(command, capsys):
    text = shown(capsys, command.name, "--help")
    assert text.startswith("examples:\n  ")
    for example in command.examples:
        assert f"  {example}\n" in text
        assert not example.endswith(f" {command.name} --help")
        if example.startswith("solari-vk ") and "--help" not in example and "|" not in example:
            parse(COMMANDS, shlex.split(example)[1:])


@pytest.mark.parametrize("name", ["render", "view", "serve", "dataset"])
def test_the_options_that_people_use_first(name, capsys):
    short, whole = shown(capsys, name, "--help"), shown(capsys, name, "--help", "all")
    listed = [set(re.findall(r"^  (?:-\w[ \w]*, )?(--[\w-]+)", text, re.MULTILINE)) for text in (short, whole)]
    assert 8 <= len(listed[0] - {"--help"}) <= 10
    assert listed[0] < listed[1]
    more = len(listed[1]) - len(listed[0])
    assert f"\n{more} more options: solari-vk {name} --help all\n" in short
    assert shown(capsys, name, "--help", "all") == whole


def test_help_as_a_word(capsys):
    for words, meant in (
        (["help"], ["--help"]),
        (["help", "all"], ["--help"]),
        (["help", "compare"], ["compare", "--help"]),
        (["help", "render", "all"], ["render", "--help", "all"]),
        (["lab", "help"], ["lab", "--help"]),
        (["lab", "help", "trial"], ["lab", "trial", "--help"]),
    ):
        assert shown(capsys, *words) == shown(capsys, *meant)
    for wrong, why in ((["render", "--help", "al"], "invalid choice: 'al'"), (["hlep"], "no command 'hlep'")):
        with pytest.raises(SystemExit):
            cli.main(wrong)
        text = capsys.readouterr().err
        assert why in text
        assert "conformance" not in text


def test_seconds_are_a_duration():
    words = ["render", "a.glb", "-o", "a.mp4", "--animate", "orbit"]
    jobs = [parse(COMMANDS, [*words, option, "3"])[1] for option in ("--seconds", "--duration")]
    assert jobs[0].duration == 3
    assert jobs[0] == jobs[1]


@pytest.mark.posix
def test_bash_completes(tmp_path, capsys):
    assert cli.main(["completion", "bash"]) == 0
    script = tmp_path / "complete.sh"
    script.write_text(capsys.readouterr().out)
    for words, expected in {
        ("re",): ["render"],
        ("render", "--sec"): ["--seconds"],
        ("render", "--mode", ""): ["auto", "realtime", "reference"],
        ("render", "model"): [],  # files, by bash itself
        ("lab", "con"): ["conformance"],
        ("lab", "bench", "fra"): ["frame", "frame-ms"],
        ("bench", "fra"): ["frame", "frame-ms"],
        ("bench", "--mark"): ["--markdown"],
        ("doctor", ""): [],
        ("help", "ren"): ["render"],
        ("completion", ""): list(SHELLS),
    }.items():
        typed = " ".join(map(shlex.quote, ("solari-vk", *words)))
        line = f"source {script}; COMP_WORDS=({typed}); COMP_CWORD={len(words)}; _solari_vk; echo ${{COMPREPLY[@]}}"
        done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=True)
        assert done.stdout.split() == expected, (words, done.stderr)


def test_scripts_of_other_shells(capsys):
    for shell, part in (("zsh", "bashcompinit"), ("fish", "-l mode -x -a 'auto realtime reference'")):
        assert cli.main(["completion", shell]) == 0
        text = capsys.readouterr().out
        assert part in text
        assert "trial" in text
        assert "__fish_use_subcommand' -f -a trial" not in text


def test_what_the_output_can_not_encode_is_escaped(monkeypatch):
    """As in a pipe on Windows."""
    monkeypatch.setattr("sys.stdout", io.TextIOWrapper(io.BytesIO(), "cp1252"))
    assert cli.main(["settings"]) == 0
    print("\u2744.png", end="", flush=True)
    assert sys.stdout.buffer.getvalue().endswith(rb"\u2744.png")


def test_libraries_beside_a_module_are_found_on_windows(monkeypatch, tmp_path):
    (tmp_path / "part.libs").mkdir()
    # Ends the process that tries it with what it is given.
    monkeypatch.setattr(info, "_LOAD", f"import os, sys\nos.add_dll_directory = sys.exit{info._LOAD}")
    assert info._why_not([str(tmp_path / "part" / "_core.pyd")]) == str(tmp_path / "part.libs")
