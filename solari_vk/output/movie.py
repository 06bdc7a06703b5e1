"""Movies from pictures: .gif by Pillow, .mp4 by ffmpeg."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from solari_vk.errors import SolariError
from solari_vk.files import whole_file

SUFFIXES = (".gif", ".mp4")


def check_encoder(path: Path) -> None:
    """Raise SolariError when this machine can't write a movie of the path's suffix."""
    if path.suffix.lower() == ".mp4":
        _find_ffmpeg(path)


def write_movie(path: Path, pictures: Sequence[Path], fps: int) -> None:
    """Write .png files, at least one and all of one size, as a .gif or .mp4 that shows `fps` of them a second.

    Raises SolariError when the file can't be written or, for an .mp4, when there is no ffmpeg.
    """
    ffmpeg = _find_ffmpeg(path) if path.suffix.lower() == ".mp4" else ""
    with whole_file(path) as temporary:
        if ffmpeg:
            _write_mp4(ffmpeg, temporary, pictures, fps)
        else:
            _write_gif(temporary, pictures, fps)


def _find_ffmpeg(path: Path) -> str:
    """The ffmpeg on the PATH, else the one that the package imageio-ffmpeg ships."""
    if found := shutil.which("ffmpeg"):
        return found
    try:
        from imageio_ffmpeg import get_ffmpeg_exe

        return str(get_ffmpeg_exe())
    except (ImportError, RuntimeError):
        raise SolariError(
            f"{path}: an .mp4 needs ffmpeg: install it by \"pip install 'solari-vk[video]'\" or put one on the PATH, "
            "or write a .gif or .png files"
        ) from None


def _write_gif(path: Path, pictures: Sequence[Path], fps: int) -> None:
    from PIL import Image

    with Image.open(pictures[0]) as first:
        others = (Image.open(picture) for picture in pictures[1:])
        first.save(path, save_all=True, append_images=others, duration=1000 / fps, loop=0)


def _write_mp4(ffmpeg: str, path: Path, pictures: Sequence[Path], fps: int) -> None:
    source = ["-f", "image2pipe", "-c:v", "png", "-framerate", str(fps), "-i", "-"]
    # yuv420p, which all players know, stores color at half the resolution: width and height must be even
    target = ["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p", str(path)]
    command = [ffmpeg, "-y", "-loglevel", "error", *source, *target]
    files = b"".join(picture.read_bytes() for picture in pictures)
    ran = subprocess.run(command, input=files, capture_output=True, check=False)
    if ran.returncode != 0:
        messages = ran.stderr.decode(errors="replace").strip().splitlines() or [f"exit code {ran.returncode}"]
        raise RuntimeError(f"ffmpeg: {messages[-1]}")
