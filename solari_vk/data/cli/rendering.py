"""Tasks of data sets and animations, rendered by the devices that a command asks for."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from solari_vk.cli.devices import Reporter, words_on
from solari_vk.cli.progress import Progress
from solari_vk.data.datasets.journal import Journal, render_missing
from solari_vk.data.datasets.tasks import Meter, RenderTask
from solari_vk.gpu.device.compile_notes import CompileNotes
from solari_vk.renderers.cluster.device_session import OneDevice
from solari_vk.renderers.cluster.worker_pool import WorkerPool

if TYPE_CHECKING:
    from solari_vk.cli.jobs import MovieJob
    from solari_vk.cli.loading import LoadedScene
    from solari_vk.data.cli.jobs import DatasetJob
    from solari_vk.data.randomize.randomizer import Randomizer
    from solari_vk.scene.model import Camera, Scene


def metered(
    pool: WorkerPool | OneDevice,
    loaded: LoadedScene,
    cameras: Sequence[Camera],
    size: tuple[int, int],
    randomizer: Randomizer | None = None,
    numbers: Sequence[int] = (),
) -> float:
    """The exposure that suits pictures of some cameras. randomizer, numbers: as of Meter."""
    # One worker measures, so that the exposure doesn't depend on how many there are.
    answers = pool.map(loaded.scene, [Meter(tuple(cameras), size, randomizer, tuple(numbers))])
    return float(next(done[1] for done in answers if done is not None))


def render_files(
    pool: WorkerPool | OneDevice, scene: Scene, tasks: list[RenderTask], journal: Journal, job: MovieJob | DatasetJob
) -> bool:
    """Render pictures into the folder of a journal, and say how many are there. Returns whether all are."""
    # Workers that see the folder write into it themselves, so that large files don't travel twice.
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
