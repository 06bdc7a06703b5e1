"""`render --show` in a real pseudo-terminal that answers as kitty, as a terminal with sixels, or not at all."""

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

import numpy as np
import pytest
from PIL import Image

from solari_vk.cli import main, terminal
from solari_vk.errors import SolariError

ROWS, COLUMNS, CELL = 14, 40, (10, 20)  # the cell's width and height in pixels
PROGRAM = """import sys
from pathlib import Path
from solari_vk.cli.terminal import show_file
show_file(Path(sys.argv[1]))
"""


def run_in_terminal(command, answers, environment=None, seconds=60.0):
    """The bytes that a command writes to a terminal, which answers each of its questions (a regular expression)."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", ROWS, COLUMNS, COLUMNS * CELL[0], ROWS * CELL[1]))
    given = {"TERM": "xterm-256color", "COLORTERM": "truecolor"} | (environment or {})
    process = subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=theirs, env=os.environ | given)
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


DEVICE_ATTRIBUTES = rb"\x1b\[c"
KITTY_QUESTION = rb"\x1b_Gi=\d+,s=1,v=1,a=q"
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
    lines = [cells for line in said.splitlines() if (cells := cell.findall(line))]
    cells = np.array(lines, int).reshape(len(lines), -1, 2, 3)
    pixels = cells.transpose(0, 2, 1, 3).reshape(2 * len(lines), -1, 3)
    assert pixels.shape == (22, 40, 3)
    assert_shows(pixels, picture, 6)
    assert len(said.splitlines()) <= ROWS


def test_kitty_gets_the_picture(picture):
    said = shown(picture, KITTY)
    parts = re.findall(rb"\x1b_Gi=(\d+),m=([01]),f=100,q=2;([^\x1b]*)\x1b", said)
    assert [more for _, more, _ in parts] == [b"1"] * (len(parts) - 1) + [b"0"]
    pixels = Image.open(io.BytesIO(base64.b64decode(b"".join(part for _, _, part in parts)))).convert("RGB")
    assert_shows(np.asarray(pixels, float), picture, 4)
    assert said.decode().count("\U0010eeee") > 300, "the cells that the picture fills"


def test_sixels_hold_the_picture(picture):
    said = shown(picture, SIXEL)
    (data,) = re.findall(rb"\x1bP[^q]*q(.*?)\x1b\\", said, re.DOTALL)
    assert_shows(decoded_sixels(data), picture, 10)  # 256 colors


def decoded_sixels(data: bytes) -> np.ndarray:
    width, height = map(int, re.match(rb'"\d+;\d+;(\d+);(\d+)', data).groups())
    pixels, palette = np.zeros((height + 5, width, 3)), {}
    color, x, y = 0, 0, 0
    token = re.compile(rb"#(\d+);2;(\d+);(\d+);(\d+)|#(\d+)|!(\d+)(.)|([$-])|([?-~])", re.DOTALL)
    for found in token.finditer(data, data.index(b"#")):
        if found[1]:  # defines a color and takes it
            color = int(found[1])
            palette[color] = np.array([int(found[i]) for i in (2, 3, 4)]) * 2.55
        elif found[5]:
            color = int(found[5])
        elif found[8]:
            x, y = 0, y + 6 * (found[8] == b"-")
        else:
            count, bits = int(found[6] or 1), (found[7] or found[9])[0] - 0x3F
            for row in range(6):
                if bits >> row & 1:
                    pixels[y + row, x : x + count] = palette[color]
            x += count
    return pixels[:height]


@pytest.mark.parametrize(("environment", "why"), [({"NO_COLOR": "1"}, "no colors"), ({"TERM": "dumb"}, "no colors")])
def test_terminals_without_colors_get_a_line(picture, environment, why):
    said = shown(picture, [], environment=environment).decode()
    assert re.fullmatch(rf"--show: .*picture.png is written, but\s+not shown: the terminal has {why}.*\s*", said)


def test_nothing_is_printed_elsewhere(picture, capfd):
    terminal.show_file(picture)
    assert capfd.readouterr() == ("", "")
    done = subprocess.run([sys.executable, "-c", PROGRAM, picture], capture_output=True, check=True)
    assert (done.stdout, done.stderr) == (b"", b"")


def test_what_cannot_be_shown_is_told_before_rendering(monkeypatch, tmp_path, capsys):
    arguments = ["render", "builtin:cornell_box", "--show", "-o"]
    assert main([*arguments, str(tmp_path / "a.exr")]) == 2
    assert capsys.readouterr().err.endswith("a.exr can't be shown in a terminal: write a .png or a .gif\n")
    assert main([*arguments, str(tmp_path / "a.png"), "--animate", "orbit"]) == 2
    assert capsys.readouterr().err.endswith("--show: numbered pictures are many files: write a .gif\n")
    monkeypatch.setattr(terminal, "find_spec", lambda name: None)
    with pytest.raises(SolariError, match=r"needs textual-image: pip install 'solari-vk\[terminal\]'$"):
        terminal.check_can_show(tmp_path / "a.png")


def test_render_shows_its_picture(any_device, tmp_path):
    target = tmp_path / "box.png"
    command = [sys.executable, "-m", "solari_vk", "render", "builtin:cornell_box", "-o", str(target), "--show",
               "--mode", "reference", "--samples", "2", "--size", "40x24"]  # fmt: skip
    said = run_in_terminal(command, KITTY)
    (payload,) = re.findall(rb",m=0,f=100,q=2;([^\x1b]*)\x1b", said)
    assert payload
    assert b"wrote " in said
    assert target.is_file()
