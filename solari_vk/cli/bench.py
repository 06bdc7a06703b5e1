"""`solari-vk bench`: its parts and their options."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from solari_vk.cli.options import add_device_options, positive, size


def add_parser(commands: Any) -> None:
    """Add the command with its parts. Without a part it measures speed."""
    bench = commands.add_parser(
        "bench", help="measure speed, loading, the realtime frame, or the claims of the posts about Solari",
        description="Measure speed (without a PART), loading, the realtime frame, or the claims of posts about Solari.",
    )  # fmt: skip
    bench.set_defaults(run=_speed, files=[])
    _add_common(bench, None)
    parts = bench.add_subparsers(metavar="PART")

    speed = parts.add_parser("speed", help="rays and samples a second, host time, loading")
    speed.set_defaults(run=_speed)
    speed.add_argument("files", nargs="*", type=Path, help="glTF files to load")

    load = parts.add_parser("load", help="sizes of files, and the times from a file to a scene on the device")
    load.set_defaults(run=_load)
    load.add_argument("files", nargs="+", type=Path, help="files with models")

    claims = parts.add_parser("claims", help="what the posts about Solari claim, as pairs of settings")
    claims.set_defaults(run=_claims)
    claims.add_argument("--only", action="append", default=[], metavar="NAME", help="one claim (all; repeatable)")

    frame = parts.add_parser("frame", help="the realtime frame: time and rays by pass, memory, growth, error over time")
    frame.set_defaults(run=_frame)
    frame.add_argument("files", nargs="*", type=Path, help="glTF files to measure beside the built-in scenes")

    frame.add_argument("--pictures", type=Path, metavar="FOLDER", help="write a picture of each scene")

    denoise = parts.add_parser("denoise", help="errors of denoised single frames, still and in motion, beside OIDN's")
    denoise.set_defaults(run=_denoise)
    denoise.add_argument("files", nargs="*", type=Path, help="glTF files to measure beside the built-in scenes")
    denoise.add_argument("--pictures", type=Path, metavar="FOLDER", help="write raw frames, denoised ones, the truth")
    denoise.add_argument("--references", type=Path, metavar="FOLDER", help="keep the path tracer's pictures there")
    denoise.add_argument("--seeds", type=positive, default=1, metavar="N", help="independent runs of each case (1)")

    cluster = parts.add_parser("cluster", help="how well several workers share the views of a data set")
    cluster.set_defaults(run=_cluster)
    cluster.add_argument("--workers", type=positive, action="append", metavar="N",
                         help="processes, one for each device (1 and 2; repeatable)")
    cluster.add_argument("--views", type=positive, default=32, metavar="N", help="views of each round (32)")
    cluster.add_argument("--size", type=size, default=(128, 128), metavar="WxH", help="of a view (128x128)")
    cluster.add_argument("--samples", type=positive, default=16, metavar="N", help="samples per pixel (16)")
    cluster.add_argument("--simulate", action="store_true", help="the load of a scheduler with many workers too")

    for part in (claims, frame, denoise):
        part.add_argument("--quick", action="store_true", help="tiny pictures and few runs, only to try the command")
    claims.add_argument("--seeds", type=positive, metavar="N", help="independent runs of each comparison (5)")
    for part in (speed, load, claims, frame, denoise, cluster):
        _add_common(part, argparse.SUPPRESS)  # an option before the part's name counts too


def _add_common(parser: argparse.ArgumentParser, default: Any) -> None:
    add_device_options(parser, default)
    parser.add_argument("--markdown", type=Path, default=default, metavar="FILE", help="write the figures as Markdown")


def _speed(options: argparse.Namespace) -> None:
    from solari_vk.measure.speed import run

    run(options.device, options.files, options.markdown, rays=options.rays)


def _load(options: argparse.Namespace) -> None:
    from solari_vk.measure.loading import run

    run(options.device, options.files, rays=options.rays, markdown=options.markdown)


def _claims(options: argparse.Namespace) -> None:
    from solari_vk.measure.claims.run import run

    run(options.device, rays=options.rays, markdown=options.markdown, only=options.only, quick=options.quick,
        seeds=options.seeds)  # fmt: skip


def _frame(options: argparse.Namespace) -> None:
    from solari_vk.measure.frame.run import run

    run(options.device, options.files, rays=options.rays, markdown=options.markdown, pictures=options.pictures,
        quick=options.quick)  # fmt: skip


def _denoise(options: argparse.Namespace) -> None:
    from solari_vk.measure.denoised import run

    run(options.device, options.files, rays=options.rays, markdown=options.markdown, pictures=options.pictures,
        references=options.references, seeds=options.seeds, quick=options.quick)  # fmt: skip


def _cluster(options: argparse.Namespace) -> None:
    from solari_vk.measure.cluster import run

    run(options.device, options.workers or (1, 2), options.views, options.size, options.samples, options.markdown,
        options.simulate, rays=options.rays)  # fmt: skip
