"""`solari-vk dataset`: many views of a scene, with their cameras, for learning from pictures."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from solari_vk.cli.cluster import add_cluster_options, open_pool, render_files
from solari_vk.cli.options import add_realtime_options, add_scene_options, count, positive
from solari_vk.cli.plan import ANIMATION_AVERAGE, make_settings
from solari_vk.cli.progress import check_time_limit
from solari_vk.cli.subject import Subject, check_aovs, load, names_of_aovs
from solari_vk.errors import SolariError
from solari_vk.files import make_folder

if TYPE_CHECKING:
    from solari_vk.cluster import RenderTask, Style, View
    from solari_vk.scene.model import Camera

METERED = 8  # views whose mean exposure is that of all
JOURNAL = "views.jsonl"


def add_parser(commands: Any) -> None:
    """Add the command with its options."""
    dataset = commands.add_parser(
        "dataset", help="render many views of a scene, with transforms.json and further outputs",
        description="Render many views of a scene into a folder, with transforms.json in the convention of NeRF. All "
        "views have one exposure. The command goes on where it was stopped.",
    )  # fmt: skip
    dataset.set_defaults(run=run, animate=None, clip=None, frames=None, fps=24)
    add_scene_options(dataset)
    dataset.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER", help="made if it isn't there")
    dataset.add_argument("--views", type=positive, metavar="N", help="the number of views (all poses of a file)")
    dataset.add_argument("--cameras", default="orbit", metavar="orbit|random|FILE",
                         help="around the scene; places all around an object, or in a room; or the poses of a JSON "
                         "file: a list of poses as --camera takes them, or a transforms.json (orbit)")
    dataset.add_argument("--mode", choices=("reference", "realtime"), default="reference",
                         help="the path tracer, or realtime lighting, which has motion vectors (reference)")
    dataset.add_argument("--aov", default="", metavar="A,B",
                         help="more outputs: layers of .exr files, otherwise .npy files; such as depth, "
                         "shading_normal, instance_id, albedo, variance; in realtime mode guides_motion, error")
    dataset.add_argument("--format", choices=("png", "exr", "npy"), default="png", help="of the pictures (png)")
    dataset.add_argument("--time", type=float, metavar="S", help="pose the scene as it is S seconds into its animation")
    dataset.add_argument("--samples", type=positive, default=64, metavar="N", help="samples per pixel (64)")
    dataset.add_argument("--max-bounces", type=count, default=16, metavar="N",
                         help="surfaces that a path may leave (16)")
    dataset.add_argument("--denoise", action="store_true", help="denoise by Intel Open Image Denoise")
    dataset.add_argument("--time-limit", type=float, metavar="S",
                         help="stop after this many seconds of rendering, with exit code 1 if views are missing")
    realtime = dataset.add_argument_group("realtime")
    add_realtime_options(realtime)
    dataset.set_defaults(view="picture", quality="medium", settings=())
    realtime.add_argument("--warm-up", type=count, default=16, metavar="N",
                          help="frames that let light accumulate first (16)")
    realtime.add_argument("--average", type=positive, default=ANIMATION_AVERAGE, metavar="N",
                          help=f"each picture is the mean of N frames ({ANIMATION_AVERAGE})")
    add_cluster_options(dataset)


def run(options: argparse.Namespace) -> int:
    """Render the views that aren't in the folder yet; returns the exit code, 1 if some are missing."""
    from solari_vk.cluster.dataset import views_of, write_transforms
    from solari_vk.cluster.journal import open_journal

    check_time_limit(options.time_limit)
    style = _style(options)
    folder: Path = options.output.resolve()
    make_folder(folder)
    subject = load(options)
    cameras, metered = _cameras(subject, options)
    with open_pool(options) as pool:
        _expose(cameras, metered, subject, options, pool)
        views = views_of(cameras, f".{options.format}")
        tasks = _tasks(style, views, options)
        journal = open_journal(folder / JOURNAL, pool, subject.scene, tasks)
        write_transforms(folder, style, views)
        return 0 if render_files(pool, subject.scene, tasks, journal, options) else 1


def _style(options: argparse.Namespace) -> Style:
    """How the options ask for views to be rendered. Raises SolariError for options that contradict each other."""
    import solari_vk as sv
    from solari_vk.cli.realtime import check_parts
    from solari_vk.cluster import Style
    from solari_vk.output import oidn

    names = names_of_aovs(options)
    realtime = options.mode == "realtime"
    if options.view != "picture":
        raise SolariError(f"--view {options.view}: a data set has pictures of light: see --aov")
    if not realtime:
        check_aovs(names, options.mode, sv.PathTracer.OUTPUTS[1:])
        if options.denoise:
            oidn.check_installed()
        return Style(
            options.size, options.seed, tuple(names), options.tonemap, samples=options.samples,
            max_bounces=options.max_bounces, denoise=options.denoise,
        )  # fmt: skip
    if options.denoise:
        raise SolariError("--denoise: is an option of --mode reference: give --settings denoise=on")
    settings = make_settings(options)
    check_aovs(names, options.mode, [name for name in sv.Renderer.OUTPUTS if name not in ("radiance", "display")])
    check_parts(options, names, settings)
    return Style(
        options.size, options.seed, tuple(names), options.tonemap, settings=settings, frames=options.average,
        warm_up=options.warm_up,
    )  # fmt: skip


def _tasks(style: Style, views: list[View], options: argparse.Namespace) -> list[RenderTask]:
    """Each view alone; or, of cameras that follow a path in realtime mode, blocks, whose motion is that of the path."""
    from solari_vk.cluster import RenderTask, blocks

    if style.settings is not None and options.cameras != "random":
        return blocks(style, views)
    warm_up = style.warm_up if style.settings is not None else 0
    return [RenderTask(style, number, (view,), (view,) * warm_up) for number, view in enumerate(views)]


def _cameras(subject: Subject, options: argparse.Namespace) -> tuple[list[Camera], list[Camera]]:
    """The cameras of the views, and those whose exposures are measured.

    At random places these are the first ones of the seed, used or not, so that any number of views has one exposure.
    """
    from solari_vk.cluster.dataset import cameras_for

    count, aspect = options.views, options.size[0] / options.size[1]
    is_random = options.cameras == "random"
    most = max(count, METERED) if is_random and count is not None else count
    found = cameras_for(options.cameras, subject.scene, subject.cameras[0], most, aspect, options.seed)
    return found[:count], found[:METERED] if is_random else found[:: -(-len(found) // METERED)]


def _expose(
    cameras: list[Camera], metered: list[Camera], subject: Subject, options: argparse.Namespace, pool: Any
) -> None:
    """Give all cameras one exposure: the one that was asked for, or the mean of what suits the metered ones."""
    from solari_vk.cluster import Meter

    ev100 = subject.cameras[0].ev100
    if subject.auto_exposure:
        meter = Meter(tuple(metered), options.size)
        ev100 = next(done[1] for done in pool.map(subject.scene, [meter]) if done is not None)
    for camera in cameras:
        camera.ev100 = ev100
    print(f"{len(cameras)} views of {options.source}, EV100 {ev100:.2f}", file=sys.stderr)
