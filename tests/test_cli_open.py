"""`render --open`: the desktop's program gets the picture; without a desktop one line says why nothing is shown."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from solari_vk.cli import desktop, main

TINY = ["render", "builtin:cornell_box", "--size", "8x8", "--mode", "reference", "--samples", "1", "--open"]


@pytest.fixture
def desktop_with(tmp_path, monkeypatch):
    """Make a desktop whose xdg-open is a shell script with these last lines; returns the file of its arguments."""
    noted = tmp_path / "opened.txt"

    def make(lines="", display="DISPLAY"):
        command = tmp_path / "xdg-open"
        command.write_text(f'#!/bin/sh\nprintf "%s" "$*" > "{noted}"\necho noise; echo noise >&2\n{lines}\n')
        command.chmod(0o755)
        monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
        for name in ("DISPLAY", "WAYLAND_DISPLAY"):
            monkeypatch.delenv(name, raising=False)
        if display:
            monkeypatch.setenv(display, ":99")
        return noted

    return make


def test_render_opens_what_it_wrote(any_device, desktop_with, tmp_path, monkeypatch, capfd):
    noted = desktop_with(display="WAYLAND_DISPLAY")
    monkeypatch.chdir(tmp_path)
    assert main([*TINY, "-o", "a picture.png"]) == 0
    assert noted.read_text() == str(tmp_path / "a picture.png")
    said = capfd.readouterr().err
    assert "wrote a picture.png" in said
    assert "noise" not in said
    assert "--open" not in said


def test_no_desktop_no_command_and_no_program_are_told(desktop_with, monkeypatch, capsys):
    def said():
        desktop.open_file(Path("a.exr"))
        (line,) = capsys.readouterr().err.splitlines()
        return line.removeprefix("--open: a.exr is written, but not shown: ")

    noted = desktop_with(display=None)
    assert said().startswith("this session has no desktop")
    desktop_with("exit 3")
    assert said() == "xdg-open found no program for .exr files (exit status 3)"
    noted.unlink()
    monkeypatch.setenv("PATH", "")
    assert said() == "xdg-open is missing: install xdg-utils"
    assert not noted.exists()


def test_a_program_that_stays_open_is_not_waited_for(desktop_with, monkeypatch, capsys):
    noted = desktop_with("exec sleep 20")
    monkeypatch.setattr(desktop, "PATIENCE", 0.5)
    began = time.monotonic()
    desktop.open_file(Path("a.png"))
    assert time.monotonic() - began < 15
    assert capsys.readouterr().err == ""
    assert noted.exists()


def test_numbered_pictures_are_no_file_to_open(tmp_path, capsys):
    assert main([*TINY[:4], "--animate", "orbit", "--open", "-o", str(tmp_path / "a.png")]) == 2
    assert "--open: numbered pictures are many files: write a .gif or an .mp4" in capsys.readouterr().err
