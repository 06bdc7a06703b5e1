"""Objects that check what is assigned to them and tell their watchers."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Any, ClassVar, Protocol

from solari_vk.errors import SolariError


class Watcher(Protocol):
    """Told of every object that changed."""

    def note(self, changed: Observable) -> None: ...


class Observable:
    """Something that tells its watchers, held weakly, when it changed."""

    _watchers: tuple[weakref.ref[Watcher], ...] = ()

    def watch(self, watcher: Watcher) -> None:
        """Have `watcher.note(self)` called on every change, for as long as the watcher lives."""
        self.unwatch(watcher)
        object.__setattr__(self, "_watchers", (*self._watchers, weakref.ref(watcher)))

    def unwatch(self, watcher: Watcher) -> None:
        """Stop telling this watcher."""
        alive = tuple(r for r in self._watchers if (w := r()) is not None and w is not watcher)
        object.__setattr__(self, "_watchers", alive)

    def _notify(self, changed: Observable) -> None:
        for reference in self._watchers:
            if (watcher := reference()) is not None:
                watcher.note(changed)

    def describe(self) -> str:
        """The object's kind and name, for messages."""
        name = getattr(self, "name", "")
        return f"{type(self).__name__} '{name}'" if name else type(self).__name__


class Checked(Observable):
    """A dataclass whose fields are checked when assigned."""

    _converters: ClassVar[dict[str, Callable[[Any], Any]]] = {}
    _ready = False

    def __post_init__(self) -> None:
        self._validate()
        object.__setattr__(self, "_ready", True)

    def __setattr__(self, name: str, value: Any) -> None:
        self.update(**{name: value})

    def update(self, **fields: Any) -> None:
        """Assign several fields at once; nothing is changed if one of them is refused."""
        known = type(self).__dataclass_fields__  # type: ignore[attr-defined]
        converted = {}
        for name, value in fields.items():
            if name not in known:
                raise SolariError(f"{self.describe()} has no field '{name}'; it has {', '.join(known)}")
            try:
                converted[name] = self._converters[name](value) if name in self._converters else value
            except (TypeError, ValueError, OverflowError) as error:
                raise SolariError(f"{self.describe()}: {name} {error}") from None
        before = {name: getattr(self, name, None) for name in fields}
        for name, value in converted.items():
            object.__setattr__(self, name, value)
        if not self._ready:
            return
        try:
            self._validate()
        except SolariError:
            for name, value in before.items():
                object.__setattr__(self, name, value)
            raise
        self._notify(self)

    def _validate(self) -> None:
        """Raise SolariError where fields don't fit together."""
