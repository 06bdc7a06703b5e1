"""`render --show` in a real pseudo-terminal that answers as kitty, as a terminal with sixels, or not at all, and
`render --open` in the desktop's program. Where that isn't possible, one line says why."""

from __future__ import annotations

import base64
import fcntl
import io
import os
import pty
import re
import select
import struct
import subprocess
import sys
import termios
import time
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from PIL import Image

from solari_vk.base.errors import SolariError
from solari_vk.cli import main, showing

ROWS = 14
COLUMNS = 40
CELL = (10, 20)  # width and height in pixels
PROGRAM = "import sys, pathlib; from solari_vk.cli.showing import show_file; show_file(pathlib.Path(sys.argv[1]))"
TINY = ["render", "builtin:cornell_box", "--size", "40x24", "--mode", "reference", "--samples", "1"]


def run_in_terminal(command, answers, environment=None, seconds=60.0):
    """The bytes that a command writes to a terminal, which answers each of its questions (a regular expression)."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", ROWS, COLUMNS, COLUMNS * CELL[0], ROWS * CELL[1]))
    given = {"TERM": "xterm-256color", "COLORTERM": "truecolor"} | (environment or {})
    # Sizes in the environment, as pytest-xdist sets them, would hide the terminal's.
    inherited = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES")}
    process = subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=theirs, env=inherited | given)
    os.close(theirs)
    said, end = b"", time.monotonic() + seconds
    waiting = list(answers)
    while time.monotonic() < end:
        try:
            part = os.read(ours, 65536) if select.select([ours], [], [], 0.1)[0] else b""
        except OSError:  # all have closed it
            break
        said += part
        for pair in [pair for pair in waiting if re.search(pair[0], said)]:
            os.write(ours, pair[1])
            waiting.remove(pair)
    os.close(ours)
    assert process.wait(5) == 0, said.decode(errors="replace")
    return said


DEVICE_ATTRIBUTES, KITTY_QUESTION = rb"\x1b\[c", rb"\x1b_Gi=\d+,s=1,v=1,a=q"
PLAIN = [(DEVICE_ATTRIBUTES, b"\x1b[?62;22c")]
KITTY = [*PLAIN, (KITTY_QUESTION, b"\x1b_Gi=1;OK\x1b\\")]
SIXEL = [(DEVICE_ATTRIBUTES, b"\x1b[?62;4;22c")]


@pytest.fixture(scope="module")
def picture(tmp_path_factory):
    """A picture with a gradient and a bright square, off center, so that turned and cut ones are noticed."""
    y, x = np.mgrid[:72, :128]
    pixels = np.stack([x * 2, y * 3, np.full_like(x, 60)], axis=2).astype(np.uint8)
    pixels[10:30, 90:110] = 250
    path = tmp_path_factory.mktemp("show") / "picture.png"
    Image.fromarray(pixels).save(path)
    return path


def shown(picture, answers, **options):
    return run_in_terminal([sys.executable, "-c", PROGRAM, str(picture)], answers, **options)


def assert_shows(pixels, picture, tolerance):
    """That pixels are those of the picture at another size, which fits into the terminal."""
    height, width = pixels.shape[:2]
    expected = np.asarray(Image.open(picture).resize((width, height)), float)
    assert np.abs(pixels - expected).mean() < tolerance


def test_half_blocks_hold_the_picture(picture):
    said = shown(picture, PLAIN).decode()
    cell = re.compile(r"38;2;(\d+);(\d+);(\d+);48;2;(\d+);(\d+);(\d+)m▀")
    found = [cell.findall(line) for line in said.splitlines()]
    lines = [cells for cells in found if cells]
    cells = np.array(lines, int).reshape(len(lines), -1, 2, 3)
    pixels = cells.transpose(0, 2, 1, 3).reshape(2 * len(lines), -1, 3)
    assert pixels.shape == (22, 40, 3)
    assert_shows(pixels, picture, 6)
    assert len(said.splitlines()) <= ROWS


def test_render_shows_its_picture_by_kitty_s_protocol(any_device, tmp_path):
    path = tmp_path / "box.png"
    said = run_in_terminal([sys.executable, "-m", "solari_vk", *TINY, "--show", "-o", str(path)], KITTY)
    assert b"wrote " in said
    parts = re.findall(rb"\x1b_Gi=(\d+),m=([01]),f=100,q=2;([^\x1b]*)\x1b", said)
    assert [more for _, more, _ in parts] == [b"1"] * (len(parts) - 1) + [b"0"]
    pixels = Image.open(io.BytesIO(base64.b64decode(b"".join(part for _, _, part in parts)))).convert("RGB")
    assert_shows(np.asarray(pixels, float), path, 4)
    assert said.decode().count("\U0010eeee") > 200, "the cells that the picture fills"


def test_sixels_fill_the_terminal(picture):
    ((width, height),) = re.findall(rb'\x1bP[^q]*q"\d+;\d+;(\d+);(\d+)#.*?\x1b\\', shown(picture, SIXEL), re.DOTALL)
    assert 0 < int(width) <= COLUMNS * CELL[0]
    assert (ROWS // 2) * CELL[1] < int(height) <= (ROWS - showing.SPARE_LINES) * CELL[1]


@pytest.mark.parametrize("environment", [{"NO_COLOR": "1"}, {"TERM": "dumb"}])
def test_terminals_without_colors_get_a_line(picture, environment):
    said = shown(picture, [], environment=environment).decode()
    assert re.fullmatch(r"--show: .*picture.png is written, but\s+not shown: the terminal has no colors.*\s*", said)


def test_nothing_is_printed_elsewhere(picture):
    done = subprocess.run([sys.executable, "-c", PROGRAM, picture], capture_output=True, check=True)
    assert (done.stdout, done.stderr) == (b"", b"")


def test_what_cannot_be_shown_is_told_before_rendering(monkeypatch, tmp_path, capsys):
    for words, why in (
        (["--show", "-o", "a.exr"], "a.exr can't be shown in a terminal: write a .png or a .gif"),
        (["--show", "--animate", "orbit", "-o", "a.png"], "--show: numbered pictures are many files: write a .gif"),
        (
            ["--open", "--animate", "orbit", "-o", "a.png"],
            "--open: numbered pictures are many files: write a .gif or an .mp4",
        ),
    ):
        assert main([*TINY[:2], *words]) == 2
        assert capsys.readouterr().err.endswith(f"{why}\n")
    monkeypatch.setattr(showing, "find_spec", lambda name: None)
    with pytest.raises(SolariError, match=r"needs textual-image: pip install 'solari-vk\[terminal\]'$"):
        showing.check_can_show(tmp_path / "a.png")


# ---- the desktop ------------------------------------------------------------------------------------


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


def test_render_opens_what_it_wrote(lent_device, desktop_with, tmp_path, monkeypatch, capfd):
    noted = desktop_with(display="WAYLAND_DISPLAY")
    monkeypatch.chdir(tmp_path)
    assert main([*TINY, "--open", "-o", "a picture.png"]) == 0
    assert noted.read_text() == str(tmp_path / "a picture.png")
    said = capfd.readouterr().err
    assert "wrote a picture.png" in said
    assert not re.search("noise|--open", said)


def test_no_desktop_no_command_and_no_program_are_told(desktop_with, monkeypatch, capsys):
    def said():
        showing.open_file(Path("a.exr"))
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


def test_windows_opens_files_itself(desktop_with, monkeypatch, capsys, tmp_path):
    opened = []
    desktop_with(display=None)
    monkeypatch.setattr(os, "startfile", opened.append, raising=False)
    showing.open_file(tmp_path / "a.exr")
    assert (opened, capsys.readouterr().err) == ([(tmp_path / "a.exr").resolve()], "")
    monkeypatch.setattr(os, "startfile", Mock(side_effect=OSError(1155, "no association")))
    showing.open_file(Path("a.exr"))
    assert "Windows found no program for .exr files (no association)" in capsys.readouterr().err


def test_a_program_that_stays_open_is_not_waited_for(desktop_with, monkeypatch, capsys, tmp_path):
    noted = desktop_with(f"sleep 20; touch '{tmp_path}/ended'")
    monkeypatch.setattr("solari_vk.output.picture.PATIENCE", 0.5)
    showing.open_file(Path("a.png"))
    assert capsys.readouterr().err == ""
    assert noted.exists()
    assert not (tmp_path / "ended").exists()
