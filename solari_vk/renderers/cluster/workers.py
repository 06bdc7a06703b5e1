"""Who takes part: workers are asked who they are, and those that would render other bits are refused."""

from __future__ import annotations

import time
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any

from distributed.comm.core import CommClosedError

from solari_vk.base.errors import SolariError
from solari_vk.renderers.cluster.device_session import Opening
from solari_vk.renderers.cluster.identity import Identity, code_hash, version
from solari_vk.renderers.cluster.worker import identify

LOOK_SECONDS = 1.0  # between looks at who came and went


class Workers:
    """The workers of a scheduler, each accepted, refused, or not known yet.

    events: a queue in which futures of the client appear when they are done; `note` takes those of the known_workers.
    """

    def __init__(self, client: Any, opening: Opening, events: SimpleQueue[Any], say: Callable[[str], None]) -> None:
        self._client, self._opening, self._events, self._say = client, opening, events, say
        self.accepted: set[str] = set()
        self.refused: dict[str, str] = {}
        """Why workers aren't used, by their addresses."""
        self.identity: Identity | None = None
        """What all accepted workers are."""
        self._asked: dict[Any, str] = {}  # futures of identities, and the workers that were asked
        self._candidates: dict[str, Identity] = {}  # before the pool has an identity
        self._looked = -LOOK_SECONDS

    @property
    def is_asking(self) -> bool:
        """Whether a worker hasn't answered yet."""
        return bool(self._asked)

    def look_around(self) -> None:
        """Ask new workers who they are, and forget those that are gone. Raises SolariError without a scheduler."""
        if time.monotonic() - self._looked < LOOK_SECONDS:
            return
        self._looked = time.monotonic()
        here = self._here()
        self.accepted &= here
        for future, address in list(self._asked.items()):
            if address not in here:
                del self._asked[future]
                future.cancel()
        for address in here - self.accepted - self.refused.keys() - self._candidates.keys() - {*self._asked.values()}:
            future = self._client.submit(identify, self._opening, workers=[address], pure=False)
            self._asked[future] = address
            future.add_done_callback(self._events.put)

    def _here(self) -> set[str]:
        self.check_scheduler()
        try:
            return set(self._client.nthreads())
        except (OSError, ValueError, TimeoutError, CommClosedError):
            raise self._gone() from None

    def check_scheduler(self) -> None:
        """Raise SolariError if the scheduler is gone."""
        if self._client.status != "running":
            raise self._gone()

    def _gone(self) -> SolariError:
        return SolariError("the scheduler is gone: what was finished before is kept")

    def note(self, future: Any) -> bool:
        """Take a worker's answer. Returns whether the future was one."""
        address = self._asked.pop(future, None)
        if address is None:
            return False
        if future.status == "error":
            error = future.exception()
            self.refuse(address, f"it can't start: {str(error) or type(error).__name__}")
        elif future.status == "finished":
            identity: Identity = future.result()
            if self.identity is not None:
                self._judge(address, identity)
            else:
                self._candidates[address] = identity
        return True

    def choose(self) -> bool:
        """Take the device that most workers have, of those with this process's code. Returns whether there is one."""
        for address, identity in list(self._candidates.items()):
            mine = Identity(version(), code_hash(), identity.device, identity.driver, identity.rays)
            if difference := identity.difference(mine):
                self.refuse(address, difference)
                del self._candidates[address]
        kinds = list(self._candidates.values())
        if not kinds:
            return False
        self.identity = max(kinds, key=lambda kind: (kinds.count(kind), repr(kind)))
        for address, identity in self._candidates.items():
            self._judge(address, identity)
        self._candidates.clear()
        return True

    def _judge(self, address: str, identity: Identity) -> None:
        assert self.identity is not None
        if difference := identity.difference(self.identity):
            self.refuse(address, difference)
        else:
            self.accepted.add(address)

    def refuse(self, address: str, reason: str) -> None:
        """Leave a worker out, and say why."""
        self.accepted.discard(address)
        self.refused[address] = reason
        self._say(f"worker {address} isn't used: {reason}")
