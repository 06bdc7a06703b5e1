"""`solari-vk view`: the interactive viewer."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from solari_vk.cli.numbers import count, positive, size
from solari_vk.cli.plan import make_settings
from solari_vk.cli.subject import load
from solari_vk.errors import SolariError

if TYPE_CHECKING:
    from solari_vk.cli.subject import Subject
    from solari_vk.gpu.device.device import Device


def add_parser(commands: Any) -> None:
    """Add the command with its options."""
    view = commands.add_parser("view", help="open a window on a scene: fly around, edit, compare")
    view.set_defaults(run=run, animate=None)
    view.add_argument("source", metavar="FILE|builtin:NAME", help="a .gltf or .glb file, or a built-in scene")
    view.add_argument("--mode", choices=("realtime", "reference", "split"), default="realtime",
                      help="Solari's realtime lighting, the path tracer, or both side by side (realtime)")
    view.add_argument("--size", type=size, default=(1280, 720), metavar="WxH", help="of the window (1280x720)")
    view.add_argument("--scale", default="auto", metavar="auto|0.1..1",
                      help="share of the window's width and height that is rendered (auto: what --fps allows)")
    view.add_argument("--fps", type=float, metavar="N", help="frames a second for --scale auto (60; on a CPU 7)")
    view.add_argument("--seed", type=count, default=0, help="another seed gives other noise (0)")
    view.add_argument("--scene", help="which scene of the file, by index or name (its default)")
    view.add_argument("--camera", metavar="N|NAME|JSON|FILE", help="where to begin, as for render")
    view.add_argument("--exposure", metavar="EV100|auto", help="exposure value (the camera's; auto for files)")
    view.add_argument("--tonemap", choices=("none", "reinhard", "aces", "agx"), default="agx", help="(agx)")
    view.add_argument("--view", default="picture", metavar="NAME", help="a debug view: `solari-vk views` lists them")
    view.add_argument("--quality", default="medium", metavar="NAME", help="low, medium, high or ultra (medium)")
    view.add_argument("--settings", action="append", default=[], metavar="KEY=VALUE",
                      help="set one of what `solari-vk settings` lists (repeatable)")
    view.add_argument("--lights", choices=("auto", "studio", "none"), default="auto", help="as for render (auto)")
    view.add_argument("--no-overlay", action="store_true", help="no panels over the picture")
    view.add_argument("--folder", type=Path, default=Path(), help="where F2 puts screenshots (.)")
    view.add_argument("--frames", type=positive, metavar="N", help="close after so many frames")
    view.add_argument("--screenshot", type=Path, metavar="FILE.png", help="write what the window shows last")
    view.add_argument("--device", help="part of a device's name, its index or its UUID")
    view.add_argument("--validation", action="store_true", help="run with the Vulkan validation layer")


def run(options: argparse.Namespace) -> None:
    """Show the window until it is closed."""
    import solari_vk as sv
    from solari_vk.output.picture import write_png
    from solari_vk.passes.debug_views import DEBUG_VIEWS

    if options.view not in DEBUG_VIEWS:
        raise SolariError(f"--view {options.view}: there is no such view; there are {', '.join(DEBUG_VIEWS)}")
    if options.screenshot is not None:
        sv.check_output(options.screenshot)
        if options.screenshot.suffix.lower() != ".png" or options.frames is None:
            raise SolariError(f"--screenshot {options.screenshot}: give --frames, and the name of a .png")
    settings = make_settings(options)
    subject = load(options)
    words = ["--lights", options.lights] + (["--scene", options.scene] if options.scene else [])
    is_file = not options.source.startswith("builtin:")
    with sv.Device(options.device, validation=options.validation or None) as device:
        if subject.auto_exposure:
            _meter(device, subject)
        with sv.Viewer(
            device, subject.scene, size=options.size, camera=subject.cameras[0], mode=options.mode,
            scale=options.scale, fps=options.fps, settings=settings, seed=options.seed,
            overlay=not options.no_overlay, source=options.source, source_options=words,
            load=(lambda: load(options).scene) if is_file else None, folder=options.folder,
        ) as viewer:  # fmt: skip
            viewer.pictures.view, viewer.pictures.tonemap = options.view, options.tonemap
            viewer.run(frames=options.frames)
            if options.screenshot is not None:
                write_png(options.screenshot, viewer.capture())


def _meter(device: Device, subject: Subject) -> None:
    """Expose by what a small picture shows."""
    import solari_vk as sv

    tracer = sv.PathTracer(device, subject.scene, (96, 54))
    subject.cameras[0].ev100 = sv.auto_exposure(tracer.render(subject.cameras[0], samples=16))
    tracer.close()
