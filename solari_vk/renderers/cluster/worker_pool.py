"""The workers of a dask.distributed cluster that render, and the jobs that they have at the moment.

Dask's scheduler decides who does what, and gives the jobs of a lost worker to others. A pool adds what rendering needs:
only workers with the same code and the same device take part, jobs are handed out a few at a time, so that a job list
may be endless, and each failure ends in one clear message.
"""

from __future__ import annotations

import asyncio
import os
import sys
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import wait
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from numbers import Integral
from queue import Empty, SimpleQueue
from typing import Any, Self

from solari_vk.base.errors import DeviceError, SolariError, quoted, reworded
from solari_vk.renderers.cluster.device_session import AnyJob, DeviceOptions, Results, pack
from solari_vk.renderers.cluster.identity import Identity, version
from solari_vk.scene.model import Scene

JOBS_OF_WORKER = 2  # one in work, and the next, so that a worker needn't wait for its result to be fetched
TICK_SECONDS = 1.0
WORKERS_PER_CORE = 16  # each is a process
CONNECT_SECONDS = 10.0
CLOSE_SECONDS = 3.0  # after which a scheduler that doesn't answer is left
ANSWER_SECONDS = 30.0  # after which a pool doesn't wait any more for workers that don't say who they are
GIVE_UP_SECONDS = 120.0  # without any worker of this machine
TRIES = 3  # of a job on devices that fail
_LOST = object()  # in place of the result of a job that is to be tried again

GUARD = "(workers import the script that starts them: write what it does below `if __name__ == '__main__':`)"


@dataclass
class _Task:
    """A job that a worker has."""

    job: Any
    tries: int = 1
    losses: int = 0
    """How often all workers that had it ended."""
    workers: frozenset[str] = frozenset()
    """The addresses of the workers that may do it."""


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
        else:
            host, port = parse_host_port(place)
            if not host or not 0 < port < 65536:
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
        if workers is not None and (not isinstance(workers, Integral) or workers < 1):
            raise SolariError(f"WorkerPool: workers must be a whole number from 1 on, not {quoted(workers)}")
        most = WORKERS_PER_CORE * (os.cpu_count() or 1)
        if workers is not None and workers > most:
            raise SolariError(f"WorkerPool: this machine has cores for at most {most} workers, not {quoted(workers)}")
        try:
            import distributed
        except ImportError:
            raise SolariError("a cluster needs dask: install it by \"pip install 'solari-vk[cluster]'\"") from None
        if address is not None:
            _check_address(address)
        self._distributed: Any = distributed
        self._local_count = workers  # None: the workers are those of a scheduler
        self._address = address
        self._say = say
        self._device_options = DeviceOptions(device, rays, validation)
        self._finished: SimpleQueue[Any] = SimpleQueue()  # futures that are done, which dask's threads put here
        self._submissions = 0

    @property
    def shares_files(self) -> bool:
        """Whether the workers write into this machine's folders."""
        return self._local_count is not None

    @property
    def worker_count(self) -> int:
        """The number of workers that take part at the moment."""
        return len(self._workers.accepted)

    @property
    def refused(self) -> dict[str, str]:
        """Why workers aren't used, by their addresses."""
        return self._workers.refused

    @property
    def identity(self) -> Identity:
        """What all workers that take part are."""
        assert self._workers.identity is not None
        return self._workers.identity

    # ---- opening and closing ------------------------------------------------------------------------

    def __enter__(self) -> Self:
        from solari_vk.renderers.cluster.workers import Workers

        with ExitStack() as opened:
            target = self._address
            # Dask takes long to import, so modules that need it are imported when a pool is opened.
            if self._local_count is not None:
                from solari_vk.renderers.cluster.local import local_cluster

                try:
                    target = opened.enter_context(local_cluster(self._local_count, self._device_options))
                except RuntimeError as error:
                    raise SolariError(f"no worker can start: {error} {GUARD}") from None
            # Results of workers on this machine don't go through the scheduler; others may not be reachable from here.
            options = {"set_as_default": False, "direct_to_workers": self.shares_files, "timeout": CONNECT_SECONDS}
            try:
                self.client: Any = self._distributed.Client(target, **options)
                """The client of dask."""
            except (OSError, ValueError) as error:
                raise SolariError(f"no scheduler of dask answers at {self._address}: {error}") from None
            opened.callback(self._close_client)
            self._check_code_of_scheduler()
            self._workers = Workers(self.client, self._device_options, self._finished, self._say)
            self._await_workers()
            self._opened = opened.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    def _close_client(self) -> None:
        with suppress(TimeoutError):
            self.client.close(CLOSE_SECONDS)

    def _check_code_of_scheduler(self) -> None:
        """Raise SolariError for a scheduler that can't load what it passes on to workers."""
        from solari_vk.renderers.cluster.worker import identify

        if self._local_count is None:
            try:
                self.client.run_on_scheduler(repr, identify)
            except (ImportError, AttributeError) as error:
                text = (
                    f"the scheduler at {self._address} can't load solari_vk {version()}: install it there too: {error}"
                )
                raise SolariError(text) from None

    def _await_workers(self) -> None:
        """Ask the workers for their identities, and wait until there is one that can take part."""
        workers = self._workers
        started = time.monotonic()
        said = False
        if self._local_count is not None:
            self.client.wait_for_workers(self._local_count)
        while True:
            workers.poll()
            future = self._next_finished()
            if future is not None:
                workers.handle_answer(future)
            elif not said and not workers.is_asking and self._local_count is None:
                said = True
                self._say(f"waiting for a worker at {self._address}")
            seconds = time.monotonic() - started
            all_answered = not workers.is_asking or seconds > ANSWER_SECONDS
            if all_answered and workers.choose_identity():
                return
            # The workers of a scheduler may come later, those of this machine are all that there will be.
            local_count = self._local_count
            if local_count is not None and (len(workers.refused) >= local_count or seconds > GIVE_UP_SECONDS):
                raise self._no_worker()

    def _no_worker(self) -> SolariError:
        reasons = "; ".join(f"{address}: {reason}" for address, reason in self.refused.items())
        return SolariError(f"no worker can render: {reasons or 'none has answered'}")

    def _next_finished(self) -> Any:
        """A future that is done, or None after a second."""
        try:
            return self._finished.get(timeout=TICK_SECONDS)
        except Empty:
            return None

    # ---- jobs ---------------------------------------------------------------------------------------

    def map(self, scene: Scene, jobs: Iterable[AnyJob]) -> Results[AnyJob]:
        """Yield each job with its result, in the order in which they are done; and None about once a second.

        jobs may be endless: they are taken as workers become free. Raises SolariError when a job fails, and when the
        scheduler is gone. Closing the iterator calls the other jobs off.
        """
        key, data = pack(scene)
        scene_there = self._submit_scene(key, data)
        source = map(_Task, jobs)
        again: deque[_Task] = deque()  # tasks that a worker has lost, or failed to do
        out: dict[Any, _Task] = {}  # tasks that workers have, by their futures
        last_worker = time.monotonic()  # when there was one
        try:
            while True:
                self._workers.poll()
                again.extend(self._recall_stranded(out))
                while len(out) < JOBS_OF_WORKER * self.worker_count:
                    # Jobs that have been tried come first, so that their results aren't waited for at the very end.
                    task = again.popleft() if again else next(source, None)
                    if task is None:
                        break
                    out[self._send(task, key, scene_there)] = task
                if self.worker_count:
                    last_worker = time.monotonic()
                    if not out:
                        return
                elif self._local_count is not None and time.monotonic() - last_worker > GIVE_UP_SECONDS:
                    raise self._no_worker()
                # A future may be an answer of a new worker, or of a job that was cancelled meanwhile.
                future = self._next_finished()
                if future is None:
                    yield None
                elif not self._workers.handle_answer(future) and future in out:
                    task = out.pop(future)
                    result = _LOST
                    if self._succeeded(future, task):
                        result = yield from self._result(future, task)
                    if result is _LOST:
                        again.append(task)
                    else:
                        yield task.job, result
        finally:
            for future in out:
                future.cancel()

    def _submit_scene(self, key: str, data: bytes) -> Any:
        """Have the scheduler hold a scene's bytes; returns their future.

        It is a task rather than scattered data, because dask makes tasks again whose results were lost with their
        workers."""
        import dask

        with dask.config.set({"distributed.admin.large-graph-warning-threshold": len(data) + 10_000_000}):
            return self.client.submit(bytes, data, key=f"solari_vk-scene-{key}")

    def _recall_stranded(self, out: dict[Any, _Task]) -> list[_Task]:
        """Take the tasks out whose workers are all gone, and return them. Raises SolariError for one that ended all
        workers that had it, too often."""
        stranded = [future for future, task in out.items() if task.workers.isdisjoint(self._workers.accepted)]
        tasks = []
        for future in stranded:
            task = out.pop(future)
            self._recall(future, task)
            tasks.append(task)
        return tasks

    def _recall(self, future: Any, task: _Task) -> None:
        """Call a task off whose workers are all gone. Raises SolariError for the third time."""
        future.cancel()
        task.losses += 1
        if task.losses >= TRIES:
            raise SolariError(f"{task.job.name} ended every worker that had it, {TRIES} times in a row")

    def _send(self, task: _Task, key: str, scene: Any) -> Any:
        """Have a job done by one of the workers that take part, of which there must be one; returns its future."""
        from solari_vk.renderers.cluster.worker import perform

        self._submissions += 1
        task.workers = frozenset(self._workers.accepted)
        # Each submission has a key of its own: dask takes equal keys for one task, and returns an earlier result.
        future = self.client.submit(
            perform,
            self.identity,
            self._device_options,
            key,
            scene,
            task.job,
            pure=False,
            key=f"solari_vk-{self.client.id}-{self._submissions}",
            workers=list(task.workers),
        )
        future.add_done_callback(self._finished.put)
        return future

    def _succeeded(self, future: Any, task: _Task) -> bool:
        """Whether a job is done; False if it is to be tried again. Raises SolariError if it failed for good."""
        from solari_vk.renderers.cluster.worker import UnfitWorkerError

        if future.status == "finished":
            return True
        if future.status != "error":  # dask dropped it, as it does when the scheduler is gone
            self._workers.check_scheduler()
            return False
        error = future.exception()
        if isinstance(error, UnfitWorkerError):  # another process has taken the address of one that was accepted
            self._workers.refuse(*error.args)
            return False
        # Dask has given the job to several workers, each of which ended: as a driver that crashes on it does.
        if isinstance(error, self._distributed.KilledWorker):
            raise SolariError(f"{task.job.name} ended every worker that tried it: {error}")
        # A device may be lost by no fault of the job, and the worker opens it anew.
        task.tries += 1
        if isinstance(error, DeviceError) and task.tries <= TRIES:
            self._say(f"{task.job.name} is tried again: {error}")
            return False
        if isinstance(error, SolariError):
            raise reworded(error, f"{task.job.name}: {error}")
        raise error

    def _result(self, future: Any, task: _Task) -> Generator[None, None, Any]:
        """Return the result of a job that is done, _LOST if all its workers are gone; yield None meanwhile."""
        # In dask's thread, because dask waits for ever for workers that are gone to do again what they didn't send.
        fetched = asyncio.run_coroutine_threadsafe(future._result(), self.client.loop.asyncio_loop)
        try:
            while not wait([fetched], TICK_SECONDS).done:
                yield None
                self._workers.poll()
                if task.workers.isdisjoint(self._workers.accepted):
                    fetched.cancel()
                    self._recall(future, task)
                    return _LOST
            return fetched.result()
        # The result is fetched from the worker only now, which may have ended since it was done.
        except (OSError, self._distributed.CancelledError) as error:
            self._workers.check_scheduler()
            raise SolariError(f"a result was lost on its way: {error}") from None
