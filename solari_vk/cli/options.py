"""Options that several commands share, and the types of their values."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from typing import Any

from solari_vk.cli.environment import add_environment_options
from solari_vk.errors import unknown_name


def add_device_options(parser: Any, default: Any = None) -> None:
    """Add --device and --rays."""
    parser.add_argument("--device", default=default, help="part of a device's name, its index or its UUID")
    parser.add_argument("--rays", default=default, choices=("auto", "query", "pipeline"),
                        help="trace by ray queries or by ray tracing pipelines (auto: queries where there are any)")


def add_scene_options(parser: Any, window_size: tuple[int, int] | None = None) -> None:
    """Add the options that say what a command renders. window_size: the default size of a window, None for pictures."""
    width, height = window_size or (640, 360)
    pixels = "of the window" if window_size else "in pixels"
    parser.add_argument("source", metavar="FILE|builtin:NAME",
                        help="a .gltf, .glb, .obj, .ply or .stl file, or a built-in scene")
    parser.add_argument("--size", type=size, default=(width, height), metavar="WxH",
                        help=f"width and height {pixels} ({width}x{height})")
    parser.add_argument("--seed", type=count, default=0, help="seed of the random numbers, which choose the noise (0)")
    parser.add_argument("--scene", help="a scene of the file, by index or name (the file's default)")
    parser.add_argument("--variant", metavar="NAME", help="the materials of one of the file's variants")
    parser.add_argument("--up", choices=("x", "y", "z"), help="the axis of an .obj, .ply or .stl file that points up "
                        "(y; z for .stl)")
    parser.add_argument("--unit", type=float, metavar="M", help="the unit of such a file, in meters (1)")
    parser.add_argument("--strict", action="store_true", help="stop at an image that is missing or damaged")
    parser.add_argument("--camera", metavar="N|NAME|JSON|FILE",
                        help="a camera of the scene by index or name, or a pose, as JSON or in a file: "
                        "{'position': [x, y, z], 'target': [x, y, z]}")
    parser.add_argument("--exposure", metavar="EV100|auto",
                        help="exposure value (the camera's; for files with lights auto)")
    parser.add_argument("--tonemap", type=tonemap, default="agx", metavar="NAME",
                        help="tone mapping: none, reinhard, aces or agx (agx)")
    add_environment_options(parser)
    parser.add_argument("--validation", action="store_true", help="use the Vulkan validation layer")
    add_device_options(parser)


def file_words(options: argparse.Namespace) -> list[str]:
    """The options that say how a file is read, as words of a command line."""
    given = ((name, getattr(options, name)) for name in ("scene", "variant", "up", "unit"))
    words = [f"--{name}={value}" for name, value in given if value is not None]
    return [*words, "--strict"] if options.strict else words


def add_realtime_options(parser: Any) -> None:
    """Add the options of the realtime renderer, with None for those that are not given."""
    parser.add_argument("--view", type=view, metavar="NAME", help="a debug view; `solari-vk views` lists all (picture)")
    parser.add_argument("--quality", metavar="NAME", help="a preset: `solari-vk settings` lists them (medium)")
    parser.add_argument("--settings", action="append", metavar="KEY=VALUE",
                        help="change a setting: `solari-vk settings` lists them (repeatable)")


def size(text: str) -> tuple[int, int]:
    """Width and height from a text such as 640x360."""
    try:
        width, height = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a size: give one such as 640x360") from None
    if not (1 <= width <= 16384 and 1 <= height <= 16384):
        raise argparse.ArgumentTypeError("a size must be from 1x1 to 16384x16384 pixels")
    return width, height


def tonemap(text: str) -> str:
    """A tone mapping's name."""
    from solari_vk.output.tone_mapping import TONEMAPS

    return _known("tone mapping", text, TONEMAPS)


def view(text: str) -> str:
    """A debug view's name."""
    from solari_vk.passes.debug_views import DEBUG_VIEWS

    return _known("view", text, DEBUG_VIEWS)


def _known(what: str, name: str, names: Iterable[str]) -> str:
    if name not in names:
        raise argparse.ArgumentTypeError(str(unknown_name(f"there is no {what}", name, names)))
    return name


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
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None
    if number < minimum:
        raise argparse.ArgumentTypeError(f"must be at least {minimum}, not {number}")
    return number
