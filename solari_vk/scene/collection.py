"""Ordered collections of the scene's objects, indexed by number or by name."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Generic, NoReturn, SupportsIndex, TypeVar, overload

from solari_vk.base.errors import SolariError, quoted, unknown_name
from solari_vk.scene.observable import Checked

Item = TypeVar("Item", bound=Checked)


class Collection(Generic[Item]):
    """Objects in the order in which they were added. This class is read-only; `Items` can be changed.

    `c[0]` and `c[-1]` are objects by number, `c[1:3]` is a list, `c["name"]` is the first object with that name. `in`
    takes an object or a name. A loop over a collection may add and remove objects; it visits those that were there when
    it began. Raises SolariError for a number out of range and for an unknown name.
    """

    _REPLACE = "assign another one to the instances that use it"

    def __init__(self, what: str, items: Iterable[Item] = ()) -> None:
        self._what = what
        # A dict, because a set has no order.
        self._items: dict[Item, None] = dict.fromkeys(items)
        self._list: list[Item] | None = None  # the items as a list, until the next change

    def _as_list(self) -> list[Item]:
        if self._list is None:
            self._list = list(self._items)
        return self._list

    @property
    def names(self) -> list[str]:
        """The names of the objects, in order. Names need not be unique."""
        return [item.name for item in self._as_list()]

    @overload
    def __getitem__(self, key: SupportsIndex | str) -> Item: ...
    @overload
    def __getitem__(self, key: slice) -> list[Item]: ...
    def __getitem__(self, key: SupportsIndex | str | slice) -> Item | list[Item]:
        items = self._as_list()
        if isinstance(key, slice):
            return items[key]
        if isinstance(key, str):
            for item in items:
                if item.name == key:
                    return item
            raise unknown_name(f"there is no {self._what}", key, self.names)
        try:
            return items[operator.index(key)]
        except TypeError:
            raise SolariError(f"{self._what}: index by a whole number, a slice or a name, not {quoted(key)}") from None
        except IndexError:
            count = len(items)
            there = f"{count}, 0 to {count - 1}" if count else "0"
            raise SolariError(f"there is no {self._what} {quoted(key)}: the scene has {there}") from None

    def __setitem__(self, key: object, item: object) -> NoReturn:
        raise SolariError(f"a {self._what} can't be replaced by assigning to {quoted(key)}: {self._REPLACE}")

    def __len__(self) -> int:
        return len(self._items)

    def __iter__(self) -> Iterator[Item]:
        return iter(self._as_list())

    def __contains__(self, item: object) -> bool:
        # Names are searched, objects are found by hash.
        return item in self.names if isinstance(item, str) else item in self._items

    def __repr__(self) -> str:
        return f"[{', '.join(item.describe() for item in self._as_list())}]"


class Items(Collection[Item]):
    """A collection to which objects are added, each at most once, and from which they are removed."""

    _REPLACE = "change its fields, or remove it and add another one"

    def __init__(self, what: str, kinds: tuple[type, ...], changed: Callable[[Any], None]) -> None:
        super().__init__(what)
        self._kinds = kinds
        self._changed = changed

    def holds(self, item: object) -> bool:
        """Whether an object has a type that belongs in this collection."""
        return isinstance(item, self._kinds)

    def add(self, item: Item, *, at: int | None = None) -> Item:
        """Append an object and return it. at: the number that it gets, by default the last one.

        Raises SolariError if it is here already, or has another type.
        """
        if not self.holds(item):
            raise SolariError(f"a {self._what} is needed, not {type(item).__name__}")
        if item in self._items:
            raise SolariError(f"{item.describe()} is in the scene already: make another object to add it twice")
        later = [] if at is None else self._as_list()[at:]
        # A dict keeps the order of insertion: what comes later is taken out and put in again.
        for other in (item, *later):
            self._items.pop(other, None)
            self._items[other] = None
        self._list = None
        self._changed(item)
        return item

    def remove(self, item: Item | SupportsIndex | str) -> None:
        """Remove an object by itself, its number or its name. It can be added again."""
        found = item if isinstance(item, Checked) else self[item]
        if found not in self._items:
            raise SolariError(f"{found.describe()} is not in the scene")
        del self._items[found]
        self._list = None
        self._changed(found)

    def clear(self) -> None:
        """Remove all objects."""
        for item in self:
            self.remove(item)

    __delitem__ = remove

    append = add
