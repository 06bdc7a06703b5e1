"""`solari-vk render`: its options, and what both renderers take from them."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from solari_vk.cli.numbers import count, positive, size
from solari_vk.errors import SolariError

# Options of one mode only, with the default that they have there.
REFERENCE_OPTIONS: dict[str, Any] = {"samples": 256, "max_bounces": 16}
REALTIME_OPTIONS: dict[str, Any] = {
    "frames": None, "warm_up": 16, "average": None, "view": "picture", "quality": "medium", "settings": (),
    "animate": None, "fps": 24,
}  # fmt: skip


def add_parser(commands: Any) -> None:
    """Add the command with its options."""
    render = commands.add_parser(
        "render", help="render a glTF file or a built-in scene to a picture or an animation",
        description="Render a glTF file or a built-in scene. Ctrl-C keeps what there is.",
    )  # fmt: skip
    render.set_defaults(run=run)
    render.add_argument("source", metavar="FILE|builtin:NAME", help="a .gltf or .glb file, or a built-in scene")
    render.add_argument("-o", "--output", type=Path, required=True,
                        help="picture to write: .png, .exr or .npy; of an animation .gif, .mp4, or numbered pictures")
    render.add_argument("--mode", choices=("realtime", "reference"), default="realtime",
                        help="Solari's realtime lighting, or the path tracer that it is measured against (realtime)")
    render.add_argument("--size", type=size, default=(640, 360), metavar="WxH", help="pixels (640x360)")
    render.add_argument("--seed", type=count, default=0, help="another seed gives other noise (0)")
    render.add_argument("--scene", help="which scene of the file, by index or name (its default)")
    render.add_argument(
        "--camera", metavar="N|NAME|JSON|FILE",
        help="camera of the scene by index or name, or a pose: {'position': [x, y, z], 'target': [x, y, z]}",
    )  # fmt: skip
    render.add_argument("--exposure", metavar="EV100|auto", help="exposure value (the camera's; auto for files)")
    render.add_argument("--tonemap", choices=("none", "reinhard", "aces", "agx"), default="agx", help="for .png (agx)")
    render.add_argument("--aov", default="", metavar="A,B", help="more outputs: layers of an .exr, else files")
    render.add_argument("--time-limit", type=float, metavar="S", help="stop after so many seconds of rendering")
    render.add_argument("--lights", choices=("auto", "studio", "none"), default="auto",
                        help="add studio lights: auto adds them to a file that has no light of its own")
    render.add_argument("--device", help="part of a device's name, its index or its UUID")
    render.add_argument("--validation", action="store_true", help="run with the Vulkan validation layer")

    realtime = render.add_argument_group("realtime")
    realtime.add_argument("--frames", type=positive, metavar="N",
                          help="frames after the warm-up (48, or --average); of an animation: its pictures (48, or the "
                          "path's)")
    realtime.add_argument("--warm-up", type=count, metavar="N", help="frames before, in which light gathers (16)")
    realtime.add_argument("--average", type=positive, metavar="N",
                          help="a picture is the mean of the last N frames (all); of an animation: of N each (4)")
    realtime.add_argument("--view", metavar="NAME", help="a debug view, as a .png: `solari-vk views` lists them")
    realtime.add_argument("--quality", metavar="NAME", help="low, medium, high or ultra (medium)")
    realtime.add_argument("--settings", action="append", metavar="KEY=VALUE",
                          help="set one of what `solari-vk settings` lists (repeatable)")
    realtime.add_argument("--animate", metavar="orbit[:DEGREES]|FILE",
                          help="go around the scene, swing by an angle, or follow a JSON list of camera poses")
    realtime.add_argument("--fps", type=positive, metavar="N", help="pictures a second of an animation (24)")

    reference = render.add_argument_group("reference")
    reference.add_argument("--samples", type=positive, metavar="N", help="samples per pixel (256)")
    reference.add_argument("--max-bounces", type=count, metavar="N", help="surfaces a path may leave (16)")


def run(options: argparse.Namespace) -> None:
    """Render as the options say."""
    from solari_vk.cli import realtime, reference

    _settle_mode(options)
    if options.time_limit is not None and not options.time_limit > 0:
        raise SolariError(f"--time-limit {options.time_limit:g}: must be more than 0 seconds")
    (reference if options.mode == "reference" else realtime).run(options)


def _settle_mode(options: argparse.Namespace) -> None:
    """Refuse options of the other mode, and fill in the defaults of this one's."""
    own, other = REALTIME_OPTIONS, REFERENCE_OPTIONS
    if options.mode == "reference":
        own, other = other, own
    for name in other:
        if getattr(options, name) is not None:
            mode = "realtime" if options.mode == "reference" else "reference"
            raise SolariError(f"--{name.replace('_', '-')} is an option of --mode {mode}, not of {options.mode}")
    for name, default in own.items():
        if getattr(options, name) is None:
            setattr(options, name, default)
