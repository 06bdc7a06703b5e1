"""Opens the device of a command, or the workers with several of them."""

from __future__ import annotations

import math
import sys
import warnings
from typing import TYPE_CHECKING, Any

from solari_vk.cli.progress import Progress, Stopped
from solari_vk.gpu.device.compile_notes import CompileNotes

if TYPE_CHECKING:
    from solari_vk.cli.jobs import PictureOptions, SharedPicture
    from solari_vk.gpu.device.device import Device
    from solari_vk.renderers.cluster.device_session import OneDevice
    from solari_vk.renderers.cluster.worker_pool import WorkerPool


def open_device(job: PictureOptions, notes: CompileNotes | None = None) -> Device:
    """The device that a job asks for."""
    from solari_vk.gpu.device.device import Device

    # Warnings, such as of a card that isn't used, are lines of this command, without the line of code that led to them.
    with warnings.catch_warnings(record=True) as caught:
        device = Device(job.device, validation=job.validation or None, rays=job.rays, on_compile=notes)
    for warning in caught:
        print(f"warning: {warning.message}", file=sys.stderr)
    return device


def open_pool(job: SharedPicture) -> WorkerPool | OneDevice:
    """The workers that a job asks for, or a device of this process; a context manager."""
    from solari_vk.renderers.cluster.device_session import OneDevice
    from solari_vk.renderers.cluster.worker_pool import WorkerPool

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
        # No error: the picture is what the workers have rendered by then.
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
