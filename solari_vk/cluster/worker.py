"""What runs in worker processes of dask: the functions that `Crew` submits."""

from __future__ import annotations

import threading
from typing import Any

from distributed import get_worker

from solari_vk.cluster.bench import Bench, Job, Opening
from solari_vk.cluster.identity import Identity, device_of_worker
from solari_vk.errors import DeviceError, SolariError
from solari_vk.gpu.device.device import list_devices

_ONE_AT_A_TIME = threading.Lock()  # a Device is used by one thread at a time, and workers may have several


class UnfitWorkerError(SolariError):
    """A worker isn't what the crew needs: its address, and in what it differs."""


def identify(opening: Opening) -> Identity:
    """What the worker is. Opens its device."""
    with _ONE_AT_A_TIME:
        return _bench(opening).identity


def perform(wanted: Identity, opening: Opening, key: str, scene: bytes, job: Job) -> Any:
    """Do a job on the worker's bench. Raises UnfitWorkerError if the worker isn't what is wanted."""
    with _ONE_AT_A_TIME:
        bench = _bench(opening)
        if difference := bench.identity.difference(wanted):
            raise UnfitWorkerError(get_worker().address, difference)
        try:
            bench.show(key, scene, job.clip)
            return job.perform(bench)
        except DeviceError:
            _close_bench()
            raise
        finally:
            bench.device.check_messages()


def _bench(opening: Opening) -> Bench:
    """The worker's bench, opened on the first call and for another opening."""
    worker: Any = get_worker()
    known, bench = getattr(worker, "solari_vk_bench", (None, None))
    if known != opening:
        _close_bench()
        bench = Bench(opening.open(device_of_worker(list_devices())))
        worker.solari_vk_bench = opening, bench
    assert isinstance(bench, Bench)
    return bench


def _close_bench() -> None:
    worker: Any = get_worker()
    _, bench = getattr(worker, "solari_vk_bench", (None, None))
    worker.solari_vk_bench = None, None
    if bench is not None:
        bench.close()
