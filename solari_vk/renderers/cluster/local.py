"""A cluster of dask on this machine: a scheduler, and worker processes that share its devices."""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import dask
from distributed import Nanny, Scheduler, SpecCluster

from solari_vk.gpu.device.device import list_devices
from solari_vk.renderers.cluster.device_session import DeviceOptions


@contextmanager
def local_cluster(worker_count: int, device_options: DeviceOptions) -> Iterator[Any]:
    """Worker processes, each with a device by its UUID; devices of the same name are given in turn."""
    with device_options.open() as device:
        chosen = device.properties.uuid
        name = device.properties.name
    devices = [chosen]
    if not device_options.device:
        # All workers need devices of one kind, or their pictures would have other bits.
        alike = [report.uuid for report in list_devices() if report.name == name and not report.missing]
        devices += [uuid for uuid in alike if uuid != chosen]
    threads = software_threads(worker_count)
    here = {"dashboard": False, "host": "127.0.0.1", "dashboard_address": "127.0.0.1:0"}  # no port for others
    workers = {
        number: {
            "cls": Nanny,
            "options": here
            | {
                "nthreads": 1,
                "memory_limit": 0,
                "silence_logs": logging.CRITICAL,
                "env": {**threads, "SOLARI_VK_DEVICE": devices[number % len(devices)]},
                "preload": [__name__],
            },
        }
        for number in range(worker_count)
    }
    scheduler = {"cls": Scheduler, "options": here}
    # A process that ended is started again, and dask doesn't give up one that takes long to come back. Nobody reads the
    # profile of the workers' stacks, which takes processor time. Workers get this process's settings.
    settings = dask.config.set(
        {"distributed.deploy.lost-worker-timeout": "1 day", "distributed.worker.profile.enabled": False}
    )
    with settings, SpecCluster(workers, scheduler, silence_logs=logging.CRITICAL, name="solari_vk") as cluster:
        yield cluster


def software_threads(process_count: int) -> dict[str, str]:
    """The environment by which processes of a software device share the processor's cores, and don't fight for them."""
    # LP_NUM_THREADS is Mesa's: lavapipe starts as many threads as there are cores in each process otherwise.
    threads = max((os.cpu_count() or 1) // process_count, 1)
    return {"LP_NUM_THREADS": os.environ.get("LP_NUM_THREADS", str(threads))}


def dask_setup(worker: Any) -> None:
    """Is called in each worker when it starts: Ctrl-C in the terminal is for the process that has the pool."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
