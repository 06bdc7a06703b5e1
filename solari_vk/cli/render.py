"""`solari-vk render`: its options, and which renderer runs."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from solari_vk.cli.cluster import add_cluster_options, is_spread
from solari_vk.cli.options import add_realtime_options, add_scene_options, count, positive
from solari_vk.cli.progress import check_time_limit
from solari_vk.cli.subject import names_of_aovs
from solari_vk.errors import SolariError

# The options that only one mode has, with their defaults.
MODE_OPTIONS: dict[str, dict[str, Any]] = {
    "realtime": {
        "frames": None, "warm_up": 16, "average": None, "view": "picture", "quality": "medium", "settings": (),
        "animate": None, "fps": 24,
    },
    "reference": {"samples": None, "max_bounces": 16, "denoise": False},
}  # fmt: skip


def add_parser(commands: Any) -> None:
    """Add the command with its options."""
    render = commands.add_parser(
        "render", help="render a glTF file or a built-in scene to a picture or an animation",
        description="Render a glTF file or a built-in scene. Ctrl-C keeps what is rendered so far.",
    )  # fmt: skip
    render.set_defaults(run=run)
    add_scene_options(render)
    render.add_argument("-o", "--output", type=Path, required=True,
                        help="the picture: .png, .exr or .npy; an animation: .gif, .mp4, or numbered pictures")
    render.add_argument("--open", action="store_true", help="show what was written in the desktop's program for it")
    render.add_argument("--show", action="store_true",
                        help="show what was written in the terminal, of a .gif its first picture, if the output goes "
                        "to one; needs solari-vk[terminal]")
    render.add_argument("--mode", choices=("auto", *MODE_OPTIONS), default="auto",
                        help="realtime lighting, or the reference path tracer; auto is the mode whose options are "
                        "given, otherwise the denoised reference, or realtime where OIDN isn't installed (auto)")
    render.add_argument("--aov", default="", metavar="A,B", help="more outputs: layers of an .exr, otherwise files")
    render.add_argument("--clip", metavar="N|NAME", help="the animation that --animate file and --time take (0)")
    render.add_argument("--time", type=float, metavar="S", help="pose the scene as it is S seconds into the clip")
    render.add_argument("--time-limit", type=float, metavar="S", help="stop after this many seconds of rendering")
    render.add_argument("--target-error", type=float, metavar="E",
                        help="stop a still picture when its estimated error is this small: the root of relMSE, the "
                        "mean square of what pixels are off relative to their luminance; 0.01 is 1 %%")

    realtime = render.add_argument_group("realtime")
    add_realtime_options(realtime)
    realtime.add_argument("--frames", type=positive, metavar="N",
                          help="frames after the warm-up (48, or --average); pictures of an animation (48, or as many "
                          "as its path has)")
    realtime.add_argument("--warm-up", type=count, metavar="N", help="frames that let light accumulate first (16)")
    realtime.add_argument("--average", type=positive, metavar="N",
                          help="the picture is the mean of the last N frames (all); each picture of an animation is "
                          "the mean of N frames (4)")
    realtime.add_argument("--animate", metavar="orbit[:DEGREES]|file|FILE",
                          help="go around the scene, swing by an angle, play the file's animation (the word file), or "
                          "follow the camera poses of a JSON file")
    realtime.add_argument("--fps", type=positive, metavar="N", help="pictures a second of an animation (24)")

    reference = render.add_argument_group("reference")
    reference.add_argument("--samples", type=positive, metavar="N", help="samples per pixel (256; with --denoise 64)")
    reference.add_argument("--max-bounces", type=count, metavar="N", help="surfaces that a path may leave (16)")
    reference.add_argument("--denoise", action=argparse.BooleanOptionalAction,
                           help="denoise by Intel Open Image Denoise, which the package solari-vk[oidn] brings (off; "
                           "with --mode auto on if it is installed)")
    add_cluster_options(render)


def run(options: argparse.Namespace) -> int:
    """Render what the options ask for; returns the exit code."""
    from solari_vk.cli import desktop, realtime, reference, terminal
    from solari_vk.output import movie

    numbered = options.animate is not None and options.output.suffix.lower() not in movie.SUFFIXES
    for name, suffixes in (("open", "a .gif or an .mp4"), ("show", "a .gif")):
        if numbered and getattr(options, name):
            raise SolariError(f"--{name}: numbered pictures are many files: write {suffixes}")
    if options.show:
        terminal.check_can_show(options.output)
    _choose_mode(options)
    _fill_in_defaults(options)
    if options.target_error is not None and not options.target_error > 0:
        raise SolariError(f"--target-error {options.target_error:g}: must be more than 0, such as 0.02 for 2 %")
    check_time_limit(options.time_limit)
    code = reference.run(options) if options.mode == "reference" else realtime.run(options)
    if options.open and code == 0:
        desktop.open_file(options.output)
    if options.show and code == 0:
        terminal.show_file(options.output)
    return code


def _choose_mode(options: argparse.Namespace) -> None:
    """Replace --mode auto by the mode that has the given options and outputs, else by the best picture's.

    Where OIDN works, the denoised reference is nearest to the truth after the same time (docs/explained/denoising.md).
    """
    from solari_vk.output import movie
    from solari_vk.reference import PathTracer
    from solari_vk.renderer import Renderer

    spread = is_spread(options)
    if options.mode != "auto":
        return
    given = {mode for mode, names in MODE_OPTIONS.items() if any(getattr(options, name) is not None for name in names)}
    aovs = set(names_of_aovs(options))
    is_movie = options.output.suffix.lower() in movie.SUFFIXES
    realtime = "realtime" in given or is_movie or not aovs.issubset(PathTracer.OUTPUTS)
    reference = "reference" in given or (spread and options.animate is None) or not aovs.issubset(Renderer.OUTPUTS)
    wanted = not realtime and options.denoise is None
    works = wanted and _oidn_works()
    options.mode = "realtime" if realtime or not (reference or works) else "reference"
    if options.mode == "reference" and options.denoise is None:
        options.denoise = works


def _oidn_works() -> bool:
    """Whether OIDN is installed and loads. Says so when it is installed and doesn't."""
    from solari_vk.output import oidn

    if not oidn.is_installed():
        return False
    try:
        oidn.check_installed()
    except SolariError as error:
        print(f"the picture isn't denoised by OIDN: {error}", file=sys.stderr)
        return False
    return True


def _fill_in_defaults(options: argparse.Namespace) -> None:
    """Fill in the mode's defaults. Raises SolariError for an option of another mode."""
    for mode, defaults in MODE_OPTIONS.items():
        for name, default in defaults.items():
            given = getattr(options, name) is not None
            if given and mode != options.mode:
                raise SolariError(f"--{name.replace('_', '-')} is an option of --mode {mode}, not of {options.mode}")
            if not given and mode == options.mode:
                setattr(options, name, default)
