"""Screenshots: the picture as a PNG, its radiance as an EXR, and the command line that renders it again."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

from solari_vk.errors import SolariError
from solari_vk.files import make_folder, write_whole
from solari_vk.output.picture import save_image, write_codes
from solari_vk.settings import DEFAULTS
from solari_vk.viewer.session import Session


def take_screenshot(session: Session) -> Path:
    """Write solari-NNN.png, .exr and .txt with the next free number; returns the path of the PNG."""
    if not session.pictures.ready:
        raise SolariError("there is no picture yet")
    make_folder(session.folder)
    number = 1
    while (target := session.folder / f"solari-{number:03}.png").exists():
        number += 1
    command = command_line(session, target)
    write_codes(target, session.pictures.pixels())
    save_image(
        target.with_suffix(".exr"),
        session.pictures.radiance(),
        exposure=session.camera.exposure,
        metadata={"command": command},
    )
    write_whole(target.with_suffix(".txt"), command + "\n")
    return target


def command_line(session: Session, output: Path) -> str:
    """The `solari-vk render` command that renders what the viewer shows, as long as the scene was not edited.

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
