"""What runs in worker processes of dask: the functions that `WorkerPool` submits."""

from __future__ import annotations

import threading
from typing import Any

from distributed import get_worker

from solari_vk.base.errors import DeviceError, SolariError
from solari_vk.gpu.device.device import list_devices
from solari_vk.renderers.cluster.device_session import DeviceSession, Job, Opening
from solari_vk.renderers.cluster.identity import Identity, device_of_worker

_ONE_AT_A_TIME = threading.Lock()  # a Device is used by one thread at a time, and workers may have several


class UnfitWorkerError(SolariError):
    """A worker isn't what the pool needs: its address, and in what it differs."""


def identify(opening: Opening) -> Identity:
    """What the worker is. Opens its device."""
    with _ONE_AT_A_TIME:
        return _session(opening).identity


def perform(wanted: Identity, opening: Opening, key: str, scene: bytes, job: Job) -> Any:
    """Do a job on the worker's session. Raises UnfitWorkerError if the worker isn't what is wanted."""
    with _ONE_AT_A_TIME:
        session = _session(opening)
        if difference := session.identity.difference(wanted):
            raise UnfitWorkerError(get_worker().address, difference)
        try:
            session.show(key, scene, job.clip)
            return job.perform(session)
        except DeviceError:
            _close_bench()
            raise
        finally:
            session.device.check_messages()


def _session(opening: Opening) -> DeviceSession:
    """The worker's session, opened on the first call and for another opening."""
    worker: Any = get_worker()
    known, session = getattr(worker, "solari_vk_session", (None, None))
    if known != opening:
        _close_bench()
        session = DeviceSession(opening.open(device_of_worker(list_devices())))
        worker.solari_vk_session = opening, session
    assert isinstance(session, DeviceSession)
    return session


def _close_bench() -> None:
    worker: Any = get_worker()
    _, session = getattr(worker, "solari_vk_session", (None, None))
    worker.solari_vk_session = None, None
    if session is not None:
        session.close()
