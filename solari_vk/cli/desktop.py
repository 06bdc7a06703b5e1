"""`solari-vk render --open`: a file in the program that the desktop has for it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

PATIENCE = 5.0  # seconds to wait for an error; on some desktops xdg-open stays until its program is closed


def open_file(path: Path) -> None:
    """Open a file in the desktop's program for its kind. Where that isn't possible, standard error says why."""
    if reason := _why_not_opened(path):
        print(f"--open: {path} is written, but not shown: {reason}", file=sys.stderr)


def _why_not_opened(path: Path) -> str:
    """Open a file; returns what went wrong."""
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return "this session has no desktop (DISPLAY and WAYLAND_DISPLAY aren't set)"
    command = shutil.which("xdg-open")
    if command is None:
        return "xdg-open is missing: install xdg-utils"
    none = subprocess.DEVNULL
    process = subprocess.Popen(
        [command, str(path.resolve())], stdin=none, stdout=none, stderr=none, start_new_session=True
    )
    try:
        status = process.wait(PATIENCE)
    except subprocess.TimeoutExpired:
        return ""
    return f"xdg-open found no program for {path.suffix} files (exit status {status})" if status else ""
