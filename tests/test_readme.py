"""What the README shows: its Python runs, its commands parse, its pictures and paths are there."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

import solari_vk as sv
from solari_vk import cli

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)


@pytest.mark.filterwarnings("error:the picture")
def test_python_runs(device, tmp_path, monkeypatch):
    (program,) = blocks("python")
    for shown, run in {"(640, 360)": "(16, 9)", "range(24)": "range(2)"}.items():
        assert shown in program
        program = program.replace(shown, run)
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(compile(program, "README.md", "exec"), names)
    assert names["radiance"].shape == (9, 16, 3)
    assert names["depth"].shape == names["ball"].shape == (9, 16)
    assert names["ball"].any()
    assert names["normals"].shape == (9, 16, 4)
    assert (tmp_path / "out.png").stat().st_size > 0


def test_commands_parse():
    lines = [line.split("#")[0] for block in blocks("sh") for line in block.splitlines()]
    commands = [shlex.split(line)[1:] for line in lines if line.startswith("solari-vk ")]
    assert len(commands) >= 4
    for command in commands:
        cli._parser().parse_args(command)


def test_options_and_outputs_are_there(capsys):
    for command in ("render", "view", "conformance"):
        with pytest.raises(SystemExit):
            cli._parser().parse_args([command, "--help"])
    text = capsys.readouterr().out
    (aovs,) = re.findall(r"^\| `--aov a,b` \| [^:]*: (.*) \|$", README, re.MULTILINE)
    assert re.findall(r"`(\w+)`", aovs) == list(sv.PathTracer.OUTPUTS[1:])
    for option in re.findall(r"(?<=`)--[\w-]+", README):
        assert option in text, option


def test_builtin_scenes_are_all_named():
    (sentence,) = re.findall(r"The built-in scenes are (.*?)\.", README)
    from solari_vk.scene.builtin import SCENES

    assert set(re.findall(r"`(\w+)`", sentence)) == set(SCENES)


def test_links_lead_somewhere():
    for target in re.findall(r"\]\(([^)]+)\)", README):
        assert "://" in target or (ROOT / target).is_file(), target
