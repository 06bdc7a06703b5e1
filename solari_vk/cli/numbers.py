"""Arguments of the command line that are numbers."""

from __future__ import annotations

import argparse


def size(text: str) -> tuple[int, int]:
    """Such as 640x360."""
    try:
        width, height = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no size such as 640x360") from None
    if not (1 <= width <= 16384 and 1 <= height <= 16384):
        raise argparse.ArgumentTypeError("a size is 1x1 to 16384x16384 pixels")
    return width, height


def positive(text: str) -> int:
    """A whole number from 1 on."""
    return _integer(text, 1)


def count(text: str) -> int:
    """A whole number from 0 on."""
    return _integer(text, 0)


def _integer(text: str, least: int) -> int:
    try:
        number = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no integer") from None
    if number < least:
        raise argparse.ArgumentTypeError(f"must be at least {least}, not {number}")
    return number
