"""Moving pictures from still ones: .gif by Pillow, .mp4 by ffmpeg where it is installed."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from solari_vk.errors import SolariError
from solari_vk.output.picture import whole_file

SUFFIXES = (".gif", ".mp4")


def check_encoder(path: Path) -> None:
    """Raise SolariError when this machine can't write a movie of the path's suffix."""
    if path.suffix.lower() == ".mp4" and shutil.which("ffmpeg") is None:
        raise SolariError(f"{path}: an .mp4 needs ffmpeg on the PATH: install it, or write a .gif or .png files")


def write_movie(path: Path, pictures: Sequence[Path], fps: int) -> None:
    """Write .png files of one size, at least one, as a .gif or .mp4 that shows `fps` of them a second."""
    with whole_file(path) as temporary:
        if path.suffix.lower() == ".gif":
            _write_gif(temporary, pictures, fps)
        else:
            _write_mp4(temporary, pictures, fps)


def _write_gif(path: Path, pictures: Sequence[Path], fps: int) -> None:
    from PIL import Image

    with Image.open(pictures[0]) as first:
        others = (Image.open(picture) for picture in pictures[1:])
        first.save(path, save_all=True, append_images=others, duration=1000 / fps, loop=0)


def _write_mp4(path: Path, pictures: Sequence[Path], fps: int) -> None:
    source = ["-f", "image2pipe", "-c:v", "png", "-framerate", str(fps), "-i", "-"]
    # players want half as many colours as pixels, so even sides
    target = ["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p", str(path)]
    files = b"".join(picture.read_bytes() for picture in pictures)
    ran = subprocess.run(
        ["ffmpeg", "-y", "-loglevel", "error", *source, *target], input=files, capture_output=True, check=False
    )
    if ran.returncode != 0:
        said = ran.stderr.decode(errors="replace").strip().splitlines() or [f"exit code {ran.returncode}"]
        raise SolariError(f"{path.name}: ffmpeg can't write it: {said[-1]}")
