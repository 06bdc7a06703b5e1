"""Jobs on several devices, or on one that does them in the same way."""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from solari_vk.cli.progress import Progress, Stopped
from solari_vk.gpu.device.compile_notes import CompileNotes

if TYPE_CHECKING:
    from solari_vk.cli.jobs import DatasetJob, MovieJob, StillJob
    from solari_vk.cli.subject import Subject
    from solari_vk.cluster import OneDevice, RenderTask, WorkerPool
    from solari_vk.cluster.journal import Journal
    from solari_vk.randomize.randomizer import Randomizer
    from solari_vk.scene.model import Camera, Scene


def open_pool(job: StillJob | MovieJob | DatasetJob) -> WorkerPool | OneDevice:
    """The workers that a job asks for, or a device of this process; a context manager."""
    from solari_vk.cluster import OneDevice, WorkerPool

    choices: dict[str, Any] = {"device": job.device, "rays": job.rays, "validation": job.validation or None}
    if not job.is_spread:
        return OneDevice(**choices, on_compile=CompileNotes())
    return WorkerPool(job.workers, job.cluster, **choices)


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


def metered(
    pool: WorkerPool | OneDevice, subject: Subject, cameras: Sequence[Camera], size: tuple[int, int],
    randomizer: Randomizer | None = None, numbers: Sequence[int] = (),
) -> float:  # fmt: skip
    """The exposure that suits pictures of some cameras. randomizer, numbers: as of Meter."""
    from solari_vk.cluster import Meter

    answers = pool.map(subject.scene, [Meter(tuple(cameras), size, randomizer, tuple(numbers))])
    return float(next(done[1] for done in answers if done is not None))


def render_files(
    pool: WorkerPool | OneDevice, scene: Scene, tasks: list[RenderTask], journal: Journal, job: MovieJob | DatasetJob
) -> bool:
    """Render pictures into the folder of a journal, and say how many are there. Returns whether all are."""
    from solari_vk.cluster import OneDevice
    from solari_vk.cluster.journal import render_missing

    if pool.shares_files or job.shared_folder:
        tasks = [dataclasses.replace(task, folder=str(journal.folder)) for task in tasks]
    total = sum(len(task.views) for task in tasks)
    print(f"rendering {job.source} with {words_on(pool)}", file=sys.stderr)
    listener = pool.device.on_compile if isinstance(pool, OneDevice) else None
    notes = listener if isinstance(listener, CompileNotes) else None
    with Progress("pictures", total, job.time_limit, notes) as progress:
        report = Reporter(progress)
        done = render_missing(pool, scene, tasks, journal, report)
    if report.reason:
        print(f"{report.reason}; the same command goes on from there", file=sys.stderr)
    print(f"{journal.folder}: {done} of {total} pictures, {progress.seconds:.1f} s", file=sys.stderr)
    return done == total
