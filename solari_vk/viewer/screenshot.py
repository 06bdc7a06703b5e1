"""Screenshots: the picture as a PNG, its radiance as an EXR, and the command line that renders it again."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from solari_vk.errors import SolariError
from solari_vk.output.picture import save_image, write_png
from solari_vk.settings import DEFAULTS

if TYPE_CHECKING:
    from solari_vk.viewer.app import Viewer


def take_screenshot(viewer: Viewer) -> Path:
    """Write the next free solari-NNN.png, .exr and .txt into the viewer's folder; returns the path of the PNG."""
    if not viewer.pictures.ready:
        raise SolariError("there is no picture yet")
    viewer.folder.mkdir(parents=True, exist_ok=True)
    number = 1
    while (target := viewer.folder / f"solari-{number:03}.png").exists():
        number += 1
    command = command_line(viewer, target)
    write_png(target, viewer.pictures.pixels())
    save_image(
        target.with_suffix(".exr"),
        viewer.pictures.radiance(),
        exposure=viewer.camera.exposure,
        metadata={"command": command},
    )
    target.with_suffix(".txt").write_text(command + "\n", encoding="utf-8")
    return target


def command_line(viewer: Viewer, output: Path) -> str:
    """`solari-vk render` for what the viewer shows, unless the scene was edited.

    The reference comes out the same in every bit; so does the realtime picture if nothing was touched since the first
    frame, while otherwise its noise differs, since light gathers over frames. Of a split view it is the left side.
    """
    pictures, camera = viewer.pictures, viewer.camera
    width, height = pictures.size
    words = ["solari-vk", "render", viewer.source or "FILE", *viewer.source_options]
    words += ["-o", str(output), "--size", f"{width}x{height}"]
    words += ["--camera", json.dumps(camera.pose()), "--exposure", repr(camera.ev100), "--seed", str(pictures.seed)]
    words += ["--tonemap", pictures.tonemap]
    if pictures.mode == "reference":
        assert pictures.reference is not None
        return shlex.join([*words, "--mode", "reference", "--samples", str(pictures.reference.samples)])
    assert pictures.realtime is not None
    words += ["--warm-up", str(pictures.realtime.frame_count - 1), "--frames", "1", "--view", pictures.view]
    for name, default in DEFAULTS.items():
        value = getattr(viewer.settings, name)
        if value != default:
            words += ["--settings", f"{name}={value}"]
    return shlex.join(words)
