"""Random command lines. Nothing is rendered, since the process sees no device; what is wrong is said in one line."""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from solari_vk.base.errors import SolariError
from solari_vk.cli import info, main
from solari_vk.cli.commands import COMMANDS
from solari_vk.cli.options import make_parser
from solari_vk.renderers.cluster import worker_pool

POSE = '{"position": [1, 1, 3], "target": [0, 0, 0]}'
NUMBERS = [
    "0",
    "1",
    "-1",
    "3",
    "0.5",
    "1e308",
    "1e400",
    "-1e400",
    "nan",
    "inf",
    "-inf",
    "1e-320",
    "9" * 400,
    "9" * 5000,
    "99999999999",
    str(2**32),
    str(2**63),
    "1_0",
    "\u0663",
    "0x10",
    " 1 ",
    "1e3",
    "1" + "0" * 30,
]
TEXTS = [
    "",
    " ",
    "x",
    "-",
    "--",
    "\0",
    "\ud800",
    "\u202e\u0301\u4e16",
    "a" * 300,
    "a" * 5000,
    "a b " * 3000,
    "\n",
    "%s {0}",
    "'",
    "~",
    "x,y",
    "depth",
    "depth,,depth",
    "=",
    "=1",
    "bounces=",
    "exposure=1=2",
    "denoise=off",
    "no_such=1",
    "*",
    "auto",
    "orbit",
    "orbit:",
    "orbit:1e999",
    "orbit:" + "9" * 5000,
    "random",
    "file",
    "query",
    "1x1",
    "16384x16384",
    "0x0",
    "1x",
    "x1",
    "99999999999x1",
    "9" * 5000 + "x1",
    "1e3x1",
    "{",
    "[]",
    "{}",
    "null",
    "NaN",
    POSE,
    "[" * 20_000,
    POSE.replace("3", "Infinity"),
    POSE.replace("3", "1" + "0" * 400),
    POSE.replace("3", "9" * 5000),
    '{"transform": 1}',
]
ADDRESSES = [
    "tcp://",
    "tcp://:1",
    "tcp://x:99999999",
    "tcp://[::1",
    "tcp://127.0.0.1:9",
    "ucx://a:1",
    "inproc://a/b/c",
    "ws://x",
    "tls://a:1",
    "http://localhost",
    "://",
    "tcp://" + "9" * 5000,
    "tcp://a:" + "9" * 5000,
    "tcp://\u0663:1",
]
SOURCES = ["builtin:cornell_box", "builtin:", "builtin:x", "builtin:" + "9" * 5000, "builtin:many_lights"]
FILES = [
    "pipe",
    "pipe.json",
    "pipe.glb",
    "pipe.obj",
    "pipe.hdr",
    "folder",
    "folder.glb",
    "missing.glb",
    "cameras.json",
    "a.obj",
    "empty.json",
    "empty.glb",
    "empty.hdr",
    "zero.glb",
    "zero.json",
    "zero.hdr",
    "/dev/zero",
    "/dev/null",
    "/dev/stdin",
    "no/folder.png",
    "loop.glb",
    "a.png",
    "a.exr",
    "a.gif",
    "a.mp4",
    "a.npy",
    ".",
]


def prepare(folder: Path) -> None:
    """Put FILES into a folder, and make it the working folder, in a process that sees no device."""
    os.environ.update(VK_DRIVER_FILES=str(folder / "none"), VK_ICD_FILENAMES=str(folder / "none"))
    os.environ.update(SOLARI_VK_VALIDATION="0", SOLARI_VK_CACHE=str(folder / "cache"))
    os.environ.pop("DISPLAY", None)
    worker_pool.CONNECT_SECONDS = 0.2
    info._why_not = lambda trial: ""  # imports all optional packages, each in a process of its own
    os.chdir(folder)
    for name in ("pipe", "pipe.json", "pipe.glb", "pipe.obj", "pipe.hdr"):
        os.mkfifo(name)
    for name in ("folder", "folder.glb"):
        os.mkdir(name)
    for name in ("zero.glb", "zero.json", "zero.hdr"):
        os.symlink("/dev/zero", name)
    os.symlink("loop.glb", "loop.glb")
    for name in ("empty.json", "empty.glb", "empty.hdr"):
        Path(name).touch()
    Path("a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    Path("cameras.json").write_text(json.dumps([json.loads(POSE)] * 3))


def command_line(draw: Callable[[st.SearchStrategy[Any]], Any]) -> list[str]:
    """The words of one command with some of its options, of which few have the values that they should."""
    text = st.text(st.characters(exclude_characters="\0"), max_size=20)  # no system passes a null character
    values = st.one_of(*map(st.sampled_from, (NUMBERS, TEXTS, FILES, ADDRESSES, SOURCES)), text)
    words, parser = drawn_command(draw)
    if draw(st.integers(0, 9)) == 0:
        return [*words, *draw(st.lists(values, max_size=3))]
    for action in drawn_options(draw, parser):
        words += option_words(draw, action, values)
    for action in parser._actions:
        if not action.option_strings and not isinstance(action, argparse._SubParsersAction):
            words.append(draw(st.one_of(st.sampled_from([*SOURCES[:1] * 20, *FILES]), values)))
    return words


def drawn_command(draw: Callable[[st.SearchStrategy[Any]], Any]) -> tuple[list[str], argparse.ArgumentParser]:
    """The name of a command, perhaps with that of a command below it, and its parser."""
    words: list[str] = []
    parser = make_parser(COMMANDS)
    while True:
        below = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
        if not below or (words and not draw(st.booleans())):
            return words, parser
        words.append(draw(st.sampled_from(sorted(below[0].choices))))
        parser = below[0].choices[words[-1]]


def drawn_options(draw: Callable[[st.SearchStrategy[Any]], Any], parser: argparse.ArgumentParser) -> list[Any]:
    """The options that a command requires, and some of all."""
    options = [action for action in parser._actions if action.option_strings and "-h" not in action.option_strings]
    required = [action for action in options if action.required]
    if not options:
        return required
    return required + draw(st.lists(st.sampled_from(options), max_size=4))


def option_words(draw: Callable[[st.SearchStrategy[Any]], Any], action: Any, values: Any) -> list[str]:
    """An option with its value, in one word or in two."""
    name = draw(st.sampled_from(action.option_strings))
    if action.nargs == 0:
        return [name]
    likely = FILES if action.dest in ("output", "markdown") else sorted(map(str, action.choices or NUMBERS))
    value = draw(st.one_of(st.sampled_from(likely), values))
    return [f"{name}={value}"] if draw(st.booleans()) and name[:2] == "--" else [name, value]


def run_command(words: list[str]) -> None:
    """Raises SolariError, with what is said, for a command that ends with an error."""
    printed, said = (io.TextIOWrapper(io.BytesIO(), "utf-8", way) for way in ("strict", "backslashreplace"))
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(said):
        try:
            code = main(words)
        except SystemExit as ended:
            code = int(ended.code or 0)
    said.seek(0)
    text = said.read()
    # 1 is a check of the conformance suite that takes longer than the limit given.
    assert code in (0, 2, 3) or (code == 1 and "conformance" in words), f"{words}: {code}, {text}"
    assert "Traceback" not in text, f"{words}: {text}"
    assert code != 2 or max(map(len, text.splitlines())) < 3000, f"{words}: {text}"
    if code:
        raise SolariError(text)
