"""Screenshots: the picture as a PNG of the window's size, its radiance as an EXR, and the command line that renders it
again."""

from __future__ import annotations

import itertools
import json
import shlex
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.base.files import make_folder, write_whole
from solari_vk.output.picture import save_image, write_codes
from solari_vk.scene.model import Scene
from solari_vk.settings import DEFAULTS
from solari_vk.studio.viewer.history import Assignment, Presence
from solari_vk.studio.viewer.presenter import pixels_of
from solari_vk.studio.viewer.session import Session


def take_screenshot(session: Session) -> Path:
    """Write solari-NNN.png, .exr and .txt with the next free number; returns the path of the PNG.

    The .png has the size of the picture in the window. The .exr has the pixels that were rendered, which may be fewer.
    """
    if not session.pictures.whole:
        raise SolariError("there is no picture yet")
    make_folder(session.folder)
    numbered = (session.folder / f"solari-{number:03}.png" for number in itertools.count(1))
    # Beside the .png are an .exr and a .txt, which mustn't be another program's either.
    target = next(
        path for path in numbered if not any(path.with_suffix(end).exists() for end in (".png", ".exr", ".txt"))
    )
    command = command_line(session, target)
    area = session.picture_area
    write_codes(target, fitted(pixels_of(session.parts()), (area.width, area.height)))
    save_image(
        target.with_suffix(".exr"),
        session.pictures.radiance(),
        exposure=session.camera.exposure,
        metadata={"command": command},
    )
    # The command can't say that the picture was stretched, and has no options for edits: the text names both.
    lines = [command]
    size = session.pictures.size
    if size != (area.width, area.height):
        lines.append(
            f"# It renders {size[0]}x{size[1]} pixels, as the window did, and stretched, as in the .png, "
            f"to {area.width}x{area.height}."
        )
    edits = edit_lines(session)
    if edits:
        lines.append("# Edits that the command leaves out; Ctrl+S saves the scene with them:")
        lines += (f"# {line}" for line in edits)
    write_whole(target.with_suffix(".txt"), "\n".join(lines) + "\n")
    return target


def fitted(pixels: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    """A picture (height, width, 3), stretched to a width and height as the window stretches it."""
    from PIL import Image

    # The window's blit filters linearly, and so does this.
    if pixels.shape[1::-1] == size or 0 in size:
        return pixels
    return np.asarray(Image.fromarray(pixels).resize(size, Image.Resampling.BILINEAR))


def edit_lines(session: Session) -> list[str]:
    """What was edited in the scene, as assignments, such as `scene.materials[2].alpha = 0.5`, and calls."""
    lines: dict[str, None] = {}
    for edit in session.history:
        if isinstance(edit, Assignment) and edit.item is not session.settings:
            for field in edit.after:
                value = getattr(edit.item, field)
                place = _place(session.scene, edit.item)
                written = value.tolist() if isinstance(value, np.ndarray) else value
                lines |= {f"{place}.{field} = {written!r}": None} if place else {}
        elif isinstance(edit, Presence):
            verb = "add" if edit.added else "remove"
            lines[f"scene.{verb}({edit.item!r})"] = None
    return list(lines)


def _place(scene: Scene, item: Any) -> str:
    """The expression for an object of a scene, "" if it isn't there."""
    if item is scene:
        return "scene"
    for name in ("instances", "materials", "lights", "cameras"):
        for number, other in enumerate(getattr(scene, name)):
            if other is item:
                return f"scene.{name}[{number}]"
    return ""


def command_line(session: Session, output: Path) -> str:
    """The `solari-vk render` command that renders what the viewer shows, without the edits in `edit_lines`.

    The path tracer's picture is then equal bit by bit. The realtime picture is too if the user changed nothing since
    the first frame; otherwise its noise differs, because it accumulates over frames. In the mode "split" the command
    renders the realtime picture.
    """
    pictures = session.pictures
    camera = session.camera
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
    # The last frame is the picture, and those before it are its history.
    words += ["--warm-up", str(pictures.realtime.frame_count - 1), "--frames", "1", "--view", pictures.debug_view]
    for name, default in DEFAULTS.items():
        value = pictures.upscale if name == "upscale" else getattr(session.settings, name)
        if value != default:
            words += ["--settings", f"{name}={value}"]
    return shlex.join(words)
