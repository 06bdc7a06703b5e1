"""Movies from pictures: .gif by Pillow, .mp4 by ffmpeg."""

from __future__ import annotations

import io
import os
import shutil
import subprocess
from collections.abc import Iterable, Sequence
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING

from solari_vk.base.errors import SolariError, checked_keywords, quoted
from solari_vk.base.files import followed, whole_file

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

SUFFIXES = (".gif", ".mp4")


def check_encoder(path: Path) -> None:
    """Raise SolariError when this machine can't write a movie of the path's suffix."""
    if path.suffix.lower() == ".mp4":
        _find_ffmpeg(path)


@checked_keywords(who="solari_vk")
def save_video(path: str | os.PathLike[str], pictures: Iterable[NDArray[np.uint8]], fps: float = 24) -> None:
    """Write pictures (height, width, 3) of sRGB codes, such as those of `frame.image()`, as an .mp4 or a .gif.

    fps: pictures a second. Raises SolariError for pictures of other types or of several sizes, for none at all, for
    another suffix, for a file that can't be written, and for an .mp4 without ffmpeg.
    """
    from solari_vk.output.picture import check_output, png_bytes

    target = Path(path)
    check_output(target, SUFFIXES)
    check_encoder(target)
    if not isinstance(fps, Real) or not 0 < fps <= 1000:
        raise SolariError(f"{target}: fps is {quoted(fps)}: give a number of pictures a second, at most 1000")
    files: list[bytes] = []
    size: tuple[int, ...] = ()
    for picture in pictures:
        # Anything may come from a user; the first picture says the size.
        shape: tuple[int, ...] = getattr(picture, "shape", ())
        kind = str(getattr(picture, "dtype", type(picture).__name__))
        size = size or shape
        if shape != size or kind != "uint8" or len(shape) != 3 or shape[-1] != 3:
            raise SolariError(
                f"{target}: picture {len(files)} is {kind} {shape}: give arrays (height, width, 3) of "
                "uint8, all of one size, such as frame.image()"
            )
        files.append(png_bytes(picture))
    if not files:
        raise SolariError(f"{target}: a video needs at least one picture")
    _write(target, files, fps)


def write_movie(path: Path, pictures: Sequence[Path], fps: int) -> None:
    """Write .png files, at least one and all of one size, as a .gif or .mp4 that shows `fps` of them a second.

    Raises SolariError when the file can't be written or, for an .mp4, when there is no ffmpeg.
    """
    _write(path, [picture.read_bytes() for picture in pictures], fps)


def _write(path: Path, pictures: Sequence[bytes], fps: float) -> None:
    ffmpeg = _find_ffmpeg(path) if path.suffix.lower() == ".mp4" else ""
    with whole_file(followed(path)) as temporary:
        if ffmpeg:
            _write_mp4(ffmpeg, temporary, pictures, fps)
        else:
            _write_gif(temporary, pictures, fps)


def _find_ffmpeg(path: Path) -> str:
    """The ffmpeg on the PATH, else the one that the package imageio-ffmpeg ships."""
    found = shutil.which("ffmpeg")
    if found:
        return found
    try:
        from imageio_ffmpeg import get_ffmpeg_exe

        return str(get_ffmpeg_exe())
    except (ImportError, RuntimeError):
        raise SolariError(
            f"{path}: an .mp4 needs ffmpeg: install it by \"pip install 'solari-vk[video]'\" or put one on the PATH, "
            "or write a .gif or .png files"
        ) from None


def _write_gif(path: Path, pictures: Sequence[bytes], fps: float) -> None:
    from PIL import Image

    with Image.open(io.BytesIO(pictures[0])) as first:
        others = (Image.open(io.BytesIO(picture)) for picture in pictures[1:])
        first.save(path, save_all=True, append_images=others, duration=1000 / fps, loop=0)


def _write_mp4(ffmpeg: str, path: Path, pictures: Sequence[bytes], fps: float) -> None:
    source = ["-f", "image2pipe", "-c:v", "png", "-framerate", str(fps), "-i", "-"]
    # yuv420p, which all players know, stores color at half the resolution: width and height must be even.
    target = ["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p", str(path)]
    command = [ffmpeg, "-y", "-loglevel", "error", *source, *target]
    ran = subprocess.run(command, input=b"".join(pictures), capture_output=True, check=False)
    if ran.returncode != 0:
        messages = ran.stderr.decode(errors="replace").strip().splitlines() or [f"exit code {ran.returncode}"]
        raise RuntimeError(f"ffmpeg: {messages[-1]}")
