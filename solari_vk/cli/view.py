"""`solari-vk view`: the interactive viewer."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from solari_vk.cli.options import add_realtime_options, add_scene_options, file_words, positive
from solari_vk.errors import SolariError
from solari_vk.gpu.device.rays import IN_WORDS


def add_parser(commands: Any) -> None:
    """Add the command with its options."""
    view = commands.add_parser("view", help="open a window on a scene: fly around, edit, compare")
    view.set_defaults(run=run, animate=None, clip=None, time=None)
    add_scene_options(view, window_size=(1280, 720))
    add_realtime_options(view)
    view.set_defaults(view="picture", quality="medium", settings=[])
    view.add_argument("--mode", choices=("realtime", "reference", "split"), default="realtime",
                      help="Solari's realtime lighting, the path tracer, or both side by side (realtime)")
    view.add_argument("--scale", default="auto", metavar="auto|0.1..1",
                      help="share of the window's width and height that is rendered (auto: as much as --fps allows)")
    view.add_argument("--fps", type=float, metavar="N", help="frames a second for --scale auto (60; on a CPU 7)")
    view.add_argument("--no-overlay", action="store_true", help="show no panels over the picture")
    view.add_argument("--folder", type=Path, default=Path(), help="where F2 writes screenshots (.)")
    view.add_argument("--frames", type=positive, metavar="N", help="close after this many frames")
    view.add_argument("--screenshot", type=Path, metavar="FILE.png", help="write the window's last frame to a file")


def run(options: argparse.Namespace) -> None:
    """Show the window until it is closed."""
    import solari_vk as sv
    from solari_vk.cli.compiling import CompileNotes, open_device
    from solari_vk.cli.environment import environment_words
    from solari_vk.cli.plan import make_settings
    from solari_vk.cli.subject import load
    from solari_vk.output.picture import write_png
    from solari_vk.passes.debug_views import check_view

    if options.screenshot is not None:
        sv.check_output(options.screenshot)
        if options.screenshot.suffix.lower() != ".png" or options.frames is None:
            raise SolariError(f"--screenshot {options.screenshot}: give --frames, and the name of a .png")
    settings = make_settings(options)
    check_view(options.view, settings.lighting)
    subject = load(options)
    words = [*environment_words(options), *file_words(options)]
    is_file = not options.source.startswith("builtin:")
    with open_device(options, CompileNotes()) as device:
        if subject.auto_exposure:  # by a small picture
            with sv.PathTracer(device, subject.scene, (96, 54)) as tracer:
                tracer.render(subject.cameras[0], samples=16)
                subject.cameras[0].ev100 = tracer.auto_exposure()
        with sv.Viewer(
            device, subject.scene, size=options.size, camera=subject.cameras[0], mode=options.mode,
            scale=options.scale, fps=options.fps, settings=settings, seed=options.seed,
            overlay=not options.no_overlay, source=options.source, source_options=words,
            load=(lambda: load(options).scene) if is_file else None, folder=options.folder,
        ) as viewer:  # fmt: skip
            print(f"showing {options.source} with {device.name}, by {IN_WORDS[device.rays]}", file=sys.stderr)
            viewer.pictures.view, viewer.pictures.tonemap = options.view, options.tonemap
            viewer.run(frames=options.frames)
            if options.screenshot is not None:
                write_png(options.screenshot, viewer.capture())
