"""`solari-vk render --show` and `--open`: a picture in the terminal, or in the program that the desktop has for it."""

from __future__ import annotations

import logging
import sys
from importlib.util import find_spec
from pathlib import Path

from solari_vk.base.errors import SolariError
from solari_vk.output.picture import open_on_desktop

SUFFIXES = (".png", ".gif")
SPARE_LINES = 2  # for the prompt and the line above the picture


# ---- the desktop ------------------------------------------------------------------------------------


def open_file(path: Path) -> None:
    """Open a file in the desktop's program for its kind. Where that isn't possible, standard error says why."""
    reason = open_on_desktop(path)
    if reason:
        print(f"--open: {path} is written, but not shown: {reason}", file=sys.stderr)


# ---- the terminal -----------------------------------------------------------------------------------


def check_can_show(output: Path) -> None:
    """Raise SolariError if what is written to `output` can't be shown by `show_file`."""
    if output.suffix.lower() not in SUFFIXES:
        raise SolariError(f"--show: {output} can't be shown in a terminal: write a {' or a '.join(SUFFIXES)}")
    if find_spec("textual_image") is None:
        raise SolariError("--show: needs textual-image: pip install 'solari-vk[terminal]'")


def show_file(path: Path) -> None:
    """Show a picture where standard output is a terminal. Where that isn't possible, standard error says why."""
    reason = _show_in_terminal(path) if sys.stdout.isatty() else ""
    if reason:
        print(f"--show: {path} is written, but not shown: {reason}", file=sys.stderr)


def _show_in_terminal(path: Path) -> str:
    """Show a picture; returns what went wrong, "" if nothing did.

    textual_image asks the terminal what it can show when it is imported, by kitty's graphics protocol or by sixels.
    Other terminals get two pixels in each character.
    """
    from PIL import Image as Pixels
    from rich.console import Console

    console = Console()
    if console.color_system is None or console.no_color:
        return "the terminal has no colors (TERM, NO_COLOR)"
    if not sys.stdin.isatty():
        return "standard input is no terminal, so that the terminal can't be asked what it can show"
    if not console.width or console.height <= SPARE_LINES:
        return "the terminal has no size"
    # It warns of terminals that don't answer, before the import asks them.
    logging.getLogger("textual_image").setLevel(logging.ERROR)
    from textual_image import renderable

    with Pixels.open(path) as picture:
        pixels = picture.convert("RGB")
    image = renderable.Image(pixels, width="auto", height="auto")
    console.print(image, width=min(pixels.width, console.width), height=console.height - SPARE_LINES)
    return ""
