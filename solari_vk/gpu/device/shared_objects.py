"""Objects of a device that its users share, and that stay for the next user, such as compiled pipelines."""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Value = TypeVar("Value")


class SharedObjects(Generic[Value]):
    """Objects by what they are made from. Of those without a user, the `limit` that were used last stay."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._all: dict[Hashable, tuple[Value, Callable[[], None]]] = {}
        self._users: Counter[Hashable] = Counter()
        self._unused: OrderedDict[Hashable, None] = OrderedDict()

    def __len__(self) -> int:
        return len(self._all)

    def acquire(self, key: Hashable) -> Value | None:
        """The object with this key, which has one user more from now on; None if there is none."""
        if key not in self._all:
            return None
        self._users[key] += 1
        self._unused.pop(key, None)
        return self._all[key][0]

    def add(self, key: Hashable, value: Value, destroy: Callable[[], None]) -> None:
        """Keep a new object, which has one user. destroy: called when it goes."""
        self._all[key] = value, destroy
        self._users[key] = 1

    def release(self, key: Hashable) -> None:
        """Say that one user less needs the object."""
        # An object without users stays as the latest unused one; the one unused for longest goes first.
        self._users[key] -= 1
        if not self._users[key]:
            self._unused[key] = None
            self._trim(self._limit)

    def clear(self) -> None:
        """Destroy all objects without a user."""
        self._trim(0)

    def _trim(self, limit: int) -> None:
        while len(self._unused) > limit:
            key, _ = self._unused.popitem(last=False)
            del self._users[key]
            _, destroy = self._all.pop(key)
            destroy()
