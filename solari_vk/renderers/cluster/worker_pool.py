"""The workers of a dask.distributed cluster that render, and the jobs that they have at the moment.

Dask's scheduler decides who does what, and gives the jobs of a lost worker to others. A pool adds what rendering needs:
only workers with the same code and the same device take part, jobs are handed out a few at a time, so that a job list
may be endless, and each failure ends in one clear message.
"""

from __future__ import annotations

import os
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import ExitStack, closing
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import Any, Self

from solari_vk.base.errors import DeviceError, SolariError, quoted
from solari_vk.renderers.cluster.device_session import AnyJob, Opening, Results, pack
from solari_vk.renderers.cluster.identity import Identity
from solari_vk.scene.model import Scene

AHEAD = 2  # jobs a worker: one in work, and the next
TICK_SECONDS = 1.0
WORKERS_PER_CORE = 16  # each is a process
CONNECT_SECONDS = 10.0
BUSY = 30.0  # seconds after which a pool doesn't wait any more for workers that don't answer
PATIENCE = 120.0  # seconds without any worker of this machine after which a pool gives up
TRIES = 3  # of a job on devices that fail

GUARD = "(workers import the script that starts them: write what it does below `if __name__ == '__main__':`)"


@dataclass
class _Task:
    """A job that a worker has."""

    job: Any
    tries: int = 1
    losses: int = 0
    """How often all workers that had it ended."""
    workers: frozenset[str] = frozenset()
    """Who may do it."""


def _check_address(address: str) -> None:
    """Raise SolariError for what can't be the address of a scheduler, which dask would try for long or not get over."""
    from distributed.comm.addressing import parse_address, parse_host_port
    from distributed.comm.inproc import global_manager
    from distributed.comm.registry import get_backend
    from distributed.security import Security

    try:
        scheme, place = parse_address(address)
        get_backend(scheme).get_connector()  # a TypeError without the library of the scheme
        if scheme == "inproc":
            global_manager.validate_address(place)
        elif not (parse_host_port(place)[0] and 0 < parse_host_port(place)[1] < 65536):
            raise ValueError("it needs a host and a port")
        if scheme in ("tls", "wss") and Security().get_connection_args("client").get("ssl_context") is None:
            raise ValueError("dask's configuration has no certificates for TLS")
    except (ValueError, TypeError, ImportError) as error:
        text = f"{quoted(address)} isn't the address of a scheduler, such as tcp://host:8786: {error}"
        raise SolariError(text) from None


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


class WorkerPool:
    """Workers that render the same bits. A context manager.

    workers: the number of processes to start on this machine; each has a device of its own, or shares one if there are
    fewer devices. address: that of an existing scheduler instead, such as tcp://host:8786; its workers need the same
    version of this package. device, rays, validation: how workers open their devices, as Device takes them; by default
    a worker takes the device in its environment variable SOLARI_VK_DEVICE. say: is called with lines about workers.
    Raises SolariError if dask.distributed isn't installed, for what is no address, and if no scheduler answers or no
    worker can start.
    """

    def __init__(
        self,
        workers: int | None = None,
        address: str | None = None,
        *,
        device: str | None = None,
        rays: str | None = None,
        validation: bool | None = None,
        say: Callable[[str], None] = _say,
    ) -> None:
        if (workers is None) == (address is None):
            raise SolariError("WorkerPool: give either a number of workers, or the address of a scheduler")
        if workers is not None and (not isinstance(workers, int) or workers < 1):
            raise SolariError(f"WorkerPool: workers must be a whole number from 1 on, not {quoted(workers)}")
        if workers is not None and workers > (most := WORKERS_PER_CORE * (os.cpu_count() or 1)):
            raise SolariError(f"WorkerPool: this machine has cores for at most {most} workers, not {quoted(workers)}")
        try:
            import distributed
        except ImportError:
            raise SolariError("a cluster needs dask: install it by \"pip install 'solari-vk[cluster]'\"") from None
        if address is not None:
            _check_address(address)
        self._distributed: Any = distributed
        self._workers, self._address, self._say = workers, address, say
        self._opening = Opening(device, rays, validation)
        self._events: SimpleQueue[Any] = SimpleQueue()  # futures that are done
        self._submissions = 0

    @property
    def shares_files(self) -> bool:
        """Whether the workers write into this machine's folders."""
        return self._workers is not None

    @property
    def worker_count(self) -> int:
        """The number of workers that take part at the moment."""
        return len(self._known_workers.accepted)

    @property
    def refused(self) -> dict[str, str]:
        """Why workers aren't used, by their addresses."""
        return self._known_workers.refused

    @property
    def identity(self) -> Identity:
        """What all workers that take part are."""
        assert self._known_workers.identity is not None
        return self._known_workers.identity

    # ---- opening and closing ------------------------------------------------------------------------

    def __enter__(self) -> Self:
        from solari_vk.renderers.cluster.workers import Workers

        with ExitStack() as opened:
            target = self._address
            if self._workers is not None:
                from solari_vk.renderers.cluster.local import local_cluster

                try:
                    target = opened.enter_context(local_cluster(self._workers, self._opening))
                except RuntimeError as error:
                    raise SolariError(f"no worker can start: {error} {GUARD}") from None
            options = {"set_as_default": False, "direct_to_workers": self.shares_files, "timeout": CONNECT_SECONDS}
            try:
                self.client: Any = opened.enter_context(closing(self._distributed.Client(target, **options)))
                """The client of dask."""
            except (OSError, ValueError) as error:
                raise SolariError(f"no scheduler of dask answers at {self._address}: {error}") from None
            self._known_workers = Workers(self.client, self._opening, self._events, self._say)
            self._await_workers()
            self._opened = opened.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    def _await_workers(self) -> None:
        """Ask the workers that are here who they are, and wait until there is one that can take part."""
        known_workers, started, said = self._known_workers, time.monotonic(), False
        if self._workers is not None:
            self.client.wait_for_workers(self._workers)
        while True:
            known_workers.look_around()
            future = self._next_event()
            if future is not None:
                known_workers.note(future)
            elif not said and not known_workers.is_asking and self._workers is None:
                said = True
                self._say(f"waiting for a worker at {self._address}")
            seconds = time.monotonic() - started
            if (not known_workers.is_asking or seconds > BUSY) and known_workers.choose():
                return
            if self._workers is not None and (len(known_workers.refused) >= self._workers or seconds > PATIENCE):
                raise self._no_worker()

    def _no_worker(self) -> SolariError:
        reasons = "; ".join(f"{address}: {reason}" for address, reason in self.refused.items())
        return SolariError(f"no worker can render: {reasons or 'none has answered'}")

    def _next_event(self) -> Any:
        """A future that is done, or None after a second."""
        try:
            return self._events.get(timeout=TICK_SECONDS)
        except Empty:
            return None

    # ---- jobs ---------------------------------------------------------------------------------------

    def map(self, scene: Scene, jobs: Iterable[AnyJob]) -> Results[AnyJob]:
        """Yield each job with its result, in the order in which they are done; and None about once a second.

        jobs may be endless: they are taken as workers become free. Raises SolariError when a job fails, and when the
        scheduler is gone. Closing the iterator calls the other jobs off.
        """
        import dask

        key, data = pack(scene)
        # a task rather than scattered data, because dask makes tasks again whose results were lost with their workers
        with dask.config.set({"distributed.admin.large-graph-warning-threshold": len(data) + 10_000_000}):
            scene_there = self.client.submit(bytes, data, key=f"solari_vk-scene-{key}")
        source, again = iter(jobs), deque[_Task]()
        out: dict[Any, _Task] = {}
        seen = time.monotonic()
        try:
            while True:
                self._known_workers.look_around()
                accepted = self._known_workers.accepted
                for stranded in [future for future, task in out.items() if task.workers.isdisjoint(accepted)]:
                    stranded.cancel()
                    again.append(lost := out.pop(stranded))
                    lost.losses += 1
                    if lost.losses > TRIES:
                        raise SolariError(f"{lost.job.name} ended every worker that had it, {TRIES} times in a row")
                while len(out) < AHEAD * len(accepted):
                    task = again.popleft() if again else next(map(_Task, source), None)
                    if task is None:
                        break
                    future = self._send(task, key, scene_there)
                    out[future] = task
                    future.add_done_callback(self._events.put)
                if accepted:
                    seen = time.monotonic()
                    if not out:
                        return
                elif self._workers is not None and time.monotonic() - seen > PATIENCE:
                    raise self._no_worker()
                future = self._next_event()
                if future is None:
                    yield None
                elif not self._known_workers.note(future) and future in out:
                    task = out.pop(future)
                    if self._succeeded(future, task):
                        yield task.job, self._result(future)
                    else:
                        again.append(task)
        finally:
            for future in out:
                future.cancel()

    def _send(self, task: _Task, key: str, scene: Any) -> Any:
        """Have a job done by one of the workers that take part, of which there must be one; returns its future."""
        from solari_vk.renderers.cluster.worker import perform

        self._submissions += 1
        task.workers = frozenset(self._known_workers.accepted)
        return self.client.submit(
            perform,
            self.identity,
            self._opening,
            key,
            scene,
            task.job,
            pure=False,
            key=f"solari_vk-{self.client.id}-{self._submissions}",
            workers=list(task.workers),
        )

    def _succeeded(self, future: Any, task: _Task) -> bool:
        """Whether a job is done; False if it is to be tried again. Raises SolariError if it failed for good."""
        from solari_vk.renderers.cluster.worker import UnfitWorkerError

        if future.status == "finished":
            return True
        if future.status != "error":  # dask dropped it, as it does when the scheduler is gone
            self._known_workers.check_scheduler()
            return False
        error = future.exception()
        if isinstance(error, UnfitWorkerError):  # another process has taken the address of one that was accepted
            self._known_workers.refuse(*error.args)
            return False
        if isinstance(error, self._distributed.KilledWorker):
            raise SolariError(f"{task.job.name} ended every worker that tried it: {error}")
        task.tries += 1
        if isinstance(error, DeviceError) and task.tries <= TRIES:
            self._say(f"{task.job.name} is tried again: {error}")
            return False
        if isinstance(error, SolariError):
            raise type(error)(f"{task.job.name}: {error}")
        raise error

    def _result(self, future: Any) -> Any:
        try:
            return future.result()
        except (OSError, self._distributed.CancelledError) as error:
            self._known_workers.check_scheduler()
            raise SolariError(f"a result was lost on its way: {error}") from None
