"""Screenshots: the picture as a PNG of the window's size, its radiance as an EXR, and the command line that renders it
again."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from solari_vk.errors import SolariError
from solari_vk.files import make_folder, write_whole
from solari_vk.output.picture import save_image, write_codes
from solari_vk.settings import DEFAULTS
from solari_vk.viewer.session import Session


def take_screenshot(session: Session) -> Path:
    """Write solari-NNN.png, .exr and .txt with the next free number; returns the path of the PNG.

    The .exr has the pixels that were rendered, which may be fewer than the window's.
    """
    if not session.pictures.ready:
        raise SolariError("there is no picture yet")
    make_folder(session.folder)
    number = 1
    while (target := session.folder / f"solari-{number:03}.png").exists():
        number += 1
    command = command_line(session, target)
    write_codes(target, fitted(session.pictures.pixels(), session.window.pixels))
    save_image(
        target.with_suffix(".exr"),
        session.pictures.radiance(),
        exposure=session.camera.exposure,
        metadata={"command": command},
    )
    edits = edit_lines(session)
    noted = ["# Edits that the command leaves out, as Python writes them:", *(f"# {line}" for line in edits)]
    write_whole(target.with_suffix(".txt"), "\n".join([command, *(noted if edits else [])]) + "\n")
    return target


def fitted(pixels: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    """A picture (height, width, 3), stretched to a width and height as the window stretches it."""
    from PIL import Image

    if pixels.shape[1::-1] == size or 0 in size:
        return pixels
    return np.asarray(Image.fromarray(pixels).resize(size, Image.Resampling.BILINEAR))


def edit_lines(session: Session) -> list[str]:
    """What was edited in the panels, as assignments, such as `scene.materials[2].alpha = 0.5`."""
    lines = []
    for item, field in session.edits:
        for name in ("instances", "materials", "lights"):
            places = [n for n, other in enumerate(getattr(session.scene, name)) if other is item]
            value = getattr(item, field)
            written = value.tolist() if isinstance(value, np.ndarray) else value
            lines += [f"scene.{name}[{place}].{field} = {written!r}" for place in places[:1]]
    return lines


def command_line(session: Session, output: Path) -> str:
    """The `solari-vk render` command that renders what the viewer shows, without the edits in `edit_lines`.

    The path tracer's picture is then equal bit by bit. The realtime picture is too if the user changed nothing since
    the first frame; otherwise its noise differs, because it accumulates over frames. In the mode "split" the command
    renders the realtime picture.
    """
    pictures, camera = session.pictures, session.camera
    width, height = pictures.size
    words = ["solari-vk", "render", session.source or "FILE", *session.source_options]
    words += ["-o", str(output), "--size", f"{width}x{height}"]
    words += ["--camera", json.dumps(camera.pose()), "--exposure", repr(camera.ev100), "--seed", str(pictures.seed)]
    words += ["--tonemap", pictures.tonemap]
    if session.player.posed:
        words += ["--clip", str(session.player.number), "--time", repr(session.player.seconds)]
    if pictures.mode == "reference":
        assert pictures.reference is not None
        return shlex.join([*words, "--mode", "reference", "--samples", str(pictures.reference.tracer.samples)])
    assert pictures.realtime is not None
    words += ["--warm-up", str(pictures.realtime.frame_count - 1), "--frames", "1", "--view", pictures.view]
    for name, default in DEFAULTS.items():
        value = getattr(session.settings, name)
        if value != default:
            words += ["--settings", f"{name}={value}"]
    return shlex.join(words)
