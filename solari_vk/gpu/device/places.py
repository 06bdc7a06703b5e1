"""Memory of a size that its users take, and that stays for the next ones."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable
from functools import partial
from typing import Generic, Protocol, TypeVar

from solari_vk.gpu.device.work_queue import WorkQueue

_KEPT = 2  # free ones of a size


class Closable(Protocol):
    """What `Places` lends."""

    def close(self) -> None: ...


Place = TypeVar("Place", bound=Closable)


class Lease(Generic[Place]):
    """A use of a place, until this object is gone."""

    def __init__(self, place: Place) -> None:
        self.place = place


class Places(Generic[Place]):
    """Places by their sizes. make: one of so many bytes."""

    def __init__(self, device: WorkQueue, make: Callable[[int], Place]) -> None:
        self._device, self._make = device, make
        self._free = defaultdict[int, deque[Place]](deque)

    def __len__(self) -> int:
        """The number of free ones."""
        return sum(map(len, self._free.values()))

    def take(self, size: int) -> Place:
        """A place, which is lent, or given back, next."""
        self._device.collect()
        # The one that has been free for longest, which all work has most likely left.
        return self._free[size].popleft() if self._free[size] else self._make(size)

    def lend(self, place: Place, size: int) -> Lease[Place]:
        """Have a place be free again when the lease is gone. Any thread may drop it."""
        lease = Lease(place)
        self._device.lent.lend(lease, partial(self.give_back, place, size))
        return lease

    def give_back(self, place: Place, size: int) -> None:
        """Nobody needs a place any more."""
        free = self._free[size]
        free.append(place)
        if len(free) > _KEPT and not self._device.closed:
            self._device.retire(free.popleft().close)  # a copy to it may be due

    def close(self) -> None:
        """Close all that are free."""
        for free in self._free.values():
            while free:
                free.popleft().close()
