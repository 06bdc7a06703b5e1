"""What runs in worker processes of dask: the functions that `WorkerPool` submits."""

from __future__ import annotations

import threading
from contextlib import suppress
from typing import Any

from distributed import get_worker

from solari_vk.base.errors import DeviceError, SolariError, ValidationError
from solari_vk.gpu.device.device import list_devices
from solari_vk.renderers.cluster.device_session import DeviceOptions, DeviceSession, Job
from solari_vk.renderers.cluster.identity import Identity, device_of_worker

_ONE_AT_A_TIME = threading.Lock()  # a Device is used by one thread at a time, and workers may have several


class UnfitWorkerError(SolariError):
    """A worker isn't what the pool needs: its address, and in what it differs."""


def identify(options: DeviceOptions) -> Identity:
    """What the worker is. Opens its device."""
    with _ONE_AT_A_TIME:
        return _session(options).identity


def perform(wanted: Identity, options: DeviceOptions, key: str, scene: bytes, job: Job) -> Any:
    """Do a job on the worker's session. Raises UnfitWorkerError if the worker isn't what is wanted."""
    with _ONE_AT_A_TIME:
        session = _session(options)
        difference = session.identity.difference(wanted)
        if difference:
            raise UnfitWorkerError(get_worker().address, difference)
        try:
            session.load_scene(key, scene, job.clip)
            result = job.perform(session)
        except DeviceError:
            # A device that failed is of no use: the next job opens it anew. The pool tries this one again, so that
            # messages of validation, which come with a lost device, don't take the error's place.
            with suppress(ValidationError):
                _close_session()
            raise
        except OSError as error:  # a disk that is full or gone: which machine's?
            raise SolariError(f"worker {get_worker().address}: {error}: mend what the reason names there") from None
        except Exception:
            session.device.check_messages()
            raise
        session.device.check_messages()  # errors of validation, if it is on, end the job that caused them
        return result


def _session(options: DeviceOptions) -> DeviceSession:
    """The worker's session, opened on the first call and for other options."""
    # Dask's worker object keeps it: a module's variable would be shared by workers of one process.
    worker: Any = get_worker()
    opened_with, session = getattr(worker, "solari_vk_session", (None, None))
    if opened_with != options:
        _close_session()
        session = DeviceSession(options.open(device_of_worker(list_devices())))
        worker.solari_vk_session = options, session
    assert isinstance(session, DeviceSession)
    return session


def _close_session() -> None:
    worker: Any = get_worker()
    _, session = getattr(worker, "solari_vk_session", (None, None))
    worker.solari_vk_session = None, None
    if session is not None:
        session.close()
