"""The options that spread a command over several devices, and the reference picture of several devices."""

from __future__ import annotations

import argparse
import dataclasses
import math
import sys
from typing import TYPE_CHECKING, Any

from solari_vk.cli.compiling import CompileNotes
from solari_vk.cli.options import positive
from solari_vk.cli.progress import Progress, Stopped
from solari_vk.cli.subject import Subject
from solari_vk.errors import SolariError

if TYPE_CHECKING:
    from solari_vk.cluster import OneDevice, ReferencePicture, RenderTask, WorkerPool
    from solari_vk.cluster.journal import Journal
    from solari_vk.scene.model import Scene


def add_cluster_options(parser: Any) -> None:
    """Add --workers, --cluster and --shared-folder."""
    group = parser.add_argument_group("several devices")
    group.add_argument("--workers", type=positive, metavar="N",
                       help="render with N processes on this machine, one for each device")
    group.add_argument("--cluster", metavar="tcp://HOST:PORT",
                       help="render with the workers of this scheduler of dask")
    group.add_argument("--shared-folder", action="store_true",
                       help="the workers of --cluster write into the output's folder themselves, because it is on a "
                       "file system that they share; without it pictures are sent to this process")


def is_spread(options: argparse.Namespace) -> bool:
    """Whether the options ask for several devices. Raises SolariError if they contradict each other."""
    if options.workers is not None and options.cluster is not None:
        raise SolariError("--workers starts processes here, --cluster uses those of a scheduler: give one of the two")
    if options.shared_folder and options.cluster is None:
        raise SolariError("--shared-folder is for the workers of --cluster: the others write here anyway")
    return options.workers is not None or options.cluster is not None


def open_pool(options: argparse.Namespace) -> WorkerPool | OneDevice:
    """The workers that the options ask for, or a device of this process; a context manager."""
    from solari_vk.cluster import OneDevice, WorkerPool

    choices: dict[str, Any] = {
        "device": options.device, "rays": options.rays, "validation": options.validation or None,
    }  # fmt: skip
    if not is_spread(options):
        return OneDevice(**choices, on_compile=CompileNotes())
    return WorkerPool(options.workers, options.cluster, **choices)


class Reporter:
    """Passes progress on, and turns the end that a user or a time limit asks for into the answer True."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self.reason = ""
        """Why the work was ended early."""

    def __call__(self, done: int, error: float = math.inf) -> bool:
        try:
            self._progress(done, error)
        except Stopped as stopped:
            self.reason = str(stopped)
            return True
        return False


def words_on(pool: WorkerPool | OneDevice) -> str:
    """Who renders, for messages."""
    if pool.worker_count == 1:
        return f"1 worker with {pool.identity.device}"
    return f"{pool.worker_count} workers, each with {pool.identity.device}"


def render_files(
    pool: WorkerPool | OneDevice, scene: Scene, tasks: list[RenderTask], journal: Journal, options: argparse.Namespace
) -> bool:
    """Render pictures into the folder of a journal, and say how many are there. Returns whether all are."""
    from solari_vk.cluster import OneDevice
    from solari_vk.cluster.journal import render_missing

    if pool.shares_files or options.shared_folder:
        tasks = [dataclasses.replace(task, folder=str(journal.folder)) for task in tasks]
    total = sum(len(task.views) for task in tasks)
    print(f"rendering {options.source} with {words_on(pool)}", file=sys.stderr)
    listener = pool.device.on_compile if isinstance(pool, OneDevice) else None
    notes = listener if isinstance(listener, CompileNotes) else None
    with Progress("pictures", total, options.time_limit, notes) as progress:
        report = Reporter(progress)
        done = render_missing(pool, scene, tasks, journal, report)
    if report.reason:
        print(f"{report.reason}; the same command goes on from there", file=sys.stderr)
    print(f"{journal.folder}: {done} of {total} pictures, {progress.seconds:.1f} s", file=sys.stderr)
    return done == total


def render_spread(
    pool: WorkerPool | OneDevice, subject: Subject, options: argparse.Namespace, layers: list[str], samples: int | None,
    progress: Progress,
) -> ReferencePicture:  # fmt: skip
    """The picture that --mode reference asks for, from several devices."""
    from solari_vk.cluster import render_reference

    report = Reporter(progress)
    picture = render_reference(
        pool, subject.scene, options.size, camera=subject.cameras[0], samples=samples, seed=options.seed,
        max_bounces=options.max_bounces, layers=layers, denoise=options.denoise,
        target_error=options.target_error or 0.0, progress=report,
    )  # fmt: skip
    if report.reason:
        print(report.reason, file=sys.stderr)
    return picture
