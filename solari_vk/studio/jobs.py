"""What the commands of the viewer and of the browser are asked to do: see cli/options.py."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

from solari_vk.base.errors import SolariError
from solari_vk.cli.jobs import PictureOptions, RealtimeOptions
from solari_vk.cli.options import count, flag, option, positive, size


@dataclass(frozen=True, kw_only=True)
class ViewJob(RealtimeOptions, PictureOptions):
    """An interactive window."""

    FIRST: ClassVar = ("size", "mode", "quality", "camera", "environment", "exposure", "fps", "beside", "device")

    size: tuple[int, int] = option("width and height of the window (1280x720)", "WxH", type=size, default=(1280, 720))
    mode: str = option(
        "Solari's realtime lighting, the path tracer, or both side by side (realtime)",
        choices=("realtime", "reference", "split"),
        default="realtime",
    )
    scale: str = option(
        "share of the window's width and height that is rendered (auto: as much as --fps allows)",
        "auto|0.1..1",
        default="auto",
    )
    fps: float | None = option("frames a second for --scale auto (60; on a CPU 7)", "N", type=float)
    no_overlay: bool = flag("show no panels beside the picture")
    beside: str | None = option(
        "a second file or built-in scene, shown right of a line that can be dragged", "FILE|builtin:NAME"
    )
    folder: Path = option("where F2 writes screenshots (.)", type=Path, default=Path())
    frames: int | None = option("close after this many frames", "N", type=positive)
    screenshot: Path | None = option("write the window's last frame to a file", "FILE.png", type=Path)

    def check(self) -> None:
        """Raise SolariError for files that aren't there."""
        super().check()
        if self.beside is not None:
            replace(self, source=self.beside, beside=None).check()


@dataclass(frozen=True, kw_only=True)
class ServeJob(RealtimeOptions, PictureOptions):
    """A server for browsers."""

    DESCRIPTION: ClassVar = (
        "Show a scene in browsers, on this machine or another one. Nothing is rendered while no page is open. Ctrl-C "
        "ends it."
    )
    FIRST: ClassVar = ("size", "mode", "quality", "camera", "environment", "exposure", "host", "port", "device")
    GROUPS: ClassVar = {"server": ("host", "port", "token", "shared")}

    size: tuple[int, int] = option(
        "width and height of the picture, which the page scales (1280x720)", "WxH", type=size, default=(1280, 720)
    )
    mode: str = option(
        "Solari's realtime lighting, the path tracer once the camera rests, or both side by side (realtime)",
        choices=("realtime", "reference", "split"),
        default="realtime",
    )
    samples: int = option(
        "samples per pixel after which the path tracer's picture is finished (256)", "N", type=positive, default=256
    )
    scale: str = option(
        "share of the width and height that is rendered while the camera moves (auto: as much as --fps allows)",
        "auto|0.1..1",
        default="auto",
    )
    fps: float | None = option("frames a second for --scale auto (30; on a CPU 7)", "N", type=float)
    host: str = option(
        "the address to listen at; any but this machine's own needs a token, which is made and printed "
        "unless --token gives it (127.0.0.1)",
        "ADDRESS",
        default="127.0.0.1",
    )
    port: int = option("the port; 0 is any that is free (8765)", "N", type=count, default=8765)
    token: str | None = option("what the address must end with as ?token=, at least 8 letters and digits", "TOKEN")
    shared: bool = flag("all pages see one camera, otherwise each has its own")

    def check(self) -> None:
        """Raise SolariError for a file that isn't there, and for numbers and a token that can't be."""
        super().check()
        if self.token is not None and not re.fullmatch(r"[\w-]{8,}", self.token, re.ASCII):
            raise SolariError("--token: give at least 8 letters and digits, which nobody can guess")
        if self.fps is not None and not self.fps > 0:
            raise SolariError(f"--fps {self.fps:g}: give a number above 0")
