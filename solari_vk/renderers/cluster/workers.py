"""The workers of a scheduler: each is asked for its identity, and those that would render other bits are refused."""

from __future__ import annotations

import asyncio
import dataclasses
import time
from collections.abc import Callable
from concurrent.futures import Future, wait
from queue import SimpleQueue
from typing import Any

from distributed.comm.core import CommClosedError

from solari_vk.base.errors import SolariError
from solari_vk.renderers.cluster.device_session import DeviceOptions
from solari_vk.renderers.cluster.identity import Identity, code_hash, version
from solari_vk.renderers.cluster.worker import identify

POLL_SECONDS = 1.0  # between two looks at which workers came and went


class Workers:
    """The workers of a scheduler, each accepted, refused, or not known yet.

    finished: a queue in which the client's futures appear when they are done; `handle_answer` takes those that this
    object has submitted.
    """

    def __init__(
        self, client: Any, device_options: DeviceOptions, finished: SimpleQueue[Any], say: Callable[[str], None]
    ) -> None:
        self._client = client
        self._device_options = device_options
        self._finished = finished
        self._say = say
        self.accepted: set[str] = set()
        self.refused: dict[str, str] = {}
        """Why workers aren't used, by their addresses."""
        self.identity: Identity | None = None
        """What all accepted workers are."""
        self._asked: dict[Any, str] = {}  # futures of identities, and the addresses of the workers that were asked
        # Workers that answered before `choose_identity` has chosen what all are to be.
        self._candidates: dict[str, Identity] = {}
        self._last_poll = -POLL_SECONDS
        self._question: Future[dict[str, int]] | None = None  # to the scheduler, of which workers it has
        self._ended = ""  # the first worker that left without an answer

    @property
    def is_asking(self) -> bool:
        """Whether a worker hasn't answered yet."""
        return bool(self._asked)

    def poll(self) -> None:
        """Ask new workers for their identity, and forget those that left. Raises SolariError without a scheduler."""
        if time.monotonic() - self._last_poll < POLL_SECONDS:
            return
        self._last_poll = time.monotonic()
        connected = self._connected()
        if connected is None:
            return
        self.accepted &= connected
        for future, address in list(self._asked.items()):
            if address not in connected:
                del self._asked[future]
                future.cancel()
                self._say_it_ended(address)
        # A refused worker isn't asked again, although another process may have taken its address since.
        known = {*self.accepted, *self.refused, *self._candidates, *self._asked.values()}
        for address in connected - known:
            # pure=False: the answer of one worker isn't that of another, though the arguments are equal.
            future = self._client.submit(identify, self._device_options, workers=[address], pure=False)
            self._asked[future] = address
            future.add_done_callback(self._finished.put)

    def _say_it_ended(self, address: str) -> None:
        """Say once that a worker ended when it was asked: its nanny starts it again and again."""
        # Dask ends a worker that can't load what it is sent, as one without the package.
        if not self._ended:
            self._ended = address
            self._say(
                f"worker {address} ended before it said what it is: its log says why: is solari_vk installed there?"
            )

    def _connected(self) -> set[str] | None:
        """The addresses of the workers that the scheduler has at the moment; None as long as it doesn't answer."""
        self.check_scheduler()
        # A stopped scheduler never answers; who waited for it in dask wouldn't see Ctrl-C.
        if self._question is None:
            loop = self._client.loop.asyncio_loop
            self._question = asyncio.run_coroutine_threadsafe(self._client.scheduler.ncores(), loop)
        if not wait([self._question], POLL_SECONDS).done:
            return None
        answer = self._question
        self._question = None
        try:
            return set(answer.result())
        # Dask raises any of these, by what it was doing when the connection broke.
        except (OSError, ValueError, TimeoutError, CommClosedError):
            raise self._gone() from None

    def check_scheduler(self) -> None:
        """Raise SolariError if the scheduler is gone."""
        if self._client.status != "running":
            raise self._gone()

    def _gone(self) -> SolariError:
        return SolariError("the scheduler is gone: what was finished before is kept")

    def handle_answer(self, future: Any) -> bool:
        """Accept or refuse the worker whose identity a finished future has. Returns whether the future is of one."""
        address = self._asked.pop(future, None)
        if address is None:
            return False
        if future.status == "error":
            error = future.exception()
            self.refuse(address, f"it can't start: {str(error) or type(error).__name__}")
        elif future.status == "finished":
            identity: Identity = future.result()
            if self.identity is not None:
                self._accept_if_equal(address, identity, self.identity)
            else:
                self._candidates[address] = identity
        return True

    def choose_identity(self) -> bool:
        """Choose the identity that most workers have, of those with this process's code, and accept these workers.
        Returns whether there is any."""
        for address, identity in list(self._candidates.items()):
            with_this_code = dataclasses.replace(identity, version=version(), code=code_hash())
            difference = identity.difference(with_this_code)
            if difference:
                self.refuse(address, difference)
                del self._candidates[address]
        identities = list(self._candidates.values())
        if not identities:
            return False
        # Among equally frequent ones their text decides, so that the choice doesn't depend on who was first.
        self.identity = max(identities, key=lambda identity: (identities.count(identity), repr(identity)))
        for address, identity in self._candidates.items():
            self._accept_if_equal(address, identity, self.identity)
        self._candidates.clear()
        return True

    def _accept_if_equal(self, address: str, identity: Identity, wanted: Identity) -> None:
        difference = identity.difference(wanted)
        if difference:
            self.refuse(address, difference)
        else:
            self.accepted.add(address)

    def refuse(self, address: str, reason: str) -> None:
        """Leave a worker out, and say why."""
        self.accepted.discard(address)
        self.refused[address] = reason
        self._say(f"worker {address} isn't used: {reason}")
