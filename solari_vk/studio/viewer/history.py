"""Edits that can be undone: values of fields, and objects that are added to a scene or removed. Needs no window."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from solari_vk.base.errors import SolariError
from solari_vk.scene.collection import Items
from solari_vk.scene.observable import Checked

MOST_EDITS = 1000  # that can be undone; earlier ones are forgotten
UNREACHABLE = object()  # stands for the last edit when the scene was saved, if no undoing leads there


class Edit(Protocol):
    """Something that was done."""

    @property
    def text(self) -> str:
        """What was done, for the user."""

    def redo(self) -> None: ...
    def undo(self) -> None: ...


@dataclass
class Assignment:
    """Values of an object's fields, and those that they had before."""

    item: Any
    after: dict[str, Any]
    before: dict[str, Any]

    @property
    def text(self) -> str:
        fields = ", ".join(name.replace("_", " ") for name in self.after)
        describe = getattr(self.item, "describe", None)
        return f"{fields} of {describe() if describe else type(self.item).__name__.lower()}"

    def redo(self) -> None:
        _assign(self.item, self.after)

    def undo(self) -> None:
        _assign(self.item, self.before)

    def continues(self, other: object) -> bool:
        """Whether the fields are those of another assignment, as while a slider is dragged."""
        return isinstance(other, Assignment) and other.item is self.item and other.after.keys() == self.after.keys()


@dataclass
class Presence:
    """An object that was added to a collection of a scene as number `at`, or removed from there."""

    items: Items[Any]
    item: Any
    at: int
    added: bool

    @property
    def text(self) -> str:
        return f"{'adding' if self.added else 'removing'} {self.item.describe()}"

    def redo(self) -> None:
        self._put(self.added)

    def undo(self) -> None:
        self._put(not self.added)

    def _put(self, there: bool) -> None:
        if there:
            self.items.add(self.item, at=self.at)
        else:
            self.items.remove(self.item)


@dataclass
class Several:
    """Edits that are undone at once: all of them, or none if one raises an error."""

    text: str
    edits: Sequence[Edit]

    def redo(self) -> None:
        _all_or_none(self.edits, "redo", "undo")

    def undo(self) -> None:
        _all_or_none(self.edits[::-1], "undo", "redo")

    def continues(self, other: Several) -> bool:
        """Whether these are assignments to the same fields of the same objects, as while handles are dragged."""
        pairs = zip(self.edits, other.edits, strict=False)
        return len(self.edits) == len(other.edits) and all(
            isinstance(new, Assignment) and new.continues(old) for new, old in pairs
        )


class History:
    """The edits of a session, in order. Every change of the scene and the settings by the user goes through it.

    An edit that is refused raises SolariError, and leaves everything as it was. Assignments to the same fields of an
    object are one edit until `end_gesture`, so that a drag is undone at once.
    """

    def __init__(self) -> None:
        self.done: list[Edit] = []
        self.undone: list[Edit] = []
        self._saved: object = None  # the last edit when the scene was saved, None before the first
        self._open = False  # whether an assignment may continue the last one

    @property
    def unsaved(self) -> bool:
        """Whether there are edits that were not saved."""
        return (self.done[-1] if self.done else None) is not self._saved

    def mark_saved(self) -> None:
        """Remember that the scene was saved as it is now."""
        self._saved = self.done[-1] if self.done else None
        self._open = False

    def assign(self, item: Any, **fields: Any) -> None:
        """Assign values to fields of an object."""
        edit = Assignment(item, fields, _snapshot_of(item, fields))
        edit.redo()
        # The object may have converted or clamped the values: redoing must give what it has now.
        edit.after = _snapshot_of(item, fields)
        # While a slider is dragged, each frame assigns: together they are one edit. The last edit before saving is
        # never changed, since `unsaved` compares by it.
        last = self.done[-1] if self.done else None
        if self._open and isinstance(last, Assignment) and edit.continues(last) and last is not self._saved:
            last.after = edit.after
            self.undone.clear()
        else:
            self._append(edit)
            self._open = True

    def assign_all(self, text: str, values: Sequence[tuple[Any, dict[str, Any]]]) -> None:
        """Assign fields of several objects, as one edit that has its own text."""
        edits = [Assignment(item, fields, _snapshot_of(item, fields)) for item, fields in values]
        edit = Several(text, edits)
        last = self.done[-1] if self.done else None
        edit.redo()
        if self._open and isinstance(last, Several) and last is not self._saved and edit.continues(last):
            for old, new in zip(last.edits, edits, strict=True):
                old.after = new.after  # type: ignore[attr-defined]
            self.undone.clear()
        elif edits:
            self._append(edit)
            self._open = True

    def assign_each(self, text: str, item: Any, values: dict[str, Any]) -> None:
        """Assign several fields one after the other, as one edit that has its own text."""
        # Settings are assigned one by one; scene objects take several fields at once. After an error all are as before.
        before = _snapshot_of(item, values)
        try:
            _assign(item, values, at_once=False)
        except BaseException:
            _assign(item, before, at_once=False)
            raise
        edits = [Assignment(item, {name: values[name]}, {name: before[name]}) for name in values]
        self._append(Several(text, edits))

    def try_out(self, values: Sequence[tuple[Any, dict[str, Any]]]) -> None:
        """Assign fields of several objects without an edit, as while the user hasn't decided: all, or none if one is
        refused."""
        _all_or_none([Assignment(item, fields, _snapshot_of(item, fields)) for item, fields in values], "redo", "undo")

    def keep(self, text: str, before: Sequence[tuple[Any, dict[str, Any]]], others: Sequence[Edit] = ()) -> None:
        """Make one edit of what was tried out. before: the fields as they were. others: what was done ahead of it."""
        tried = [Assignment(item, _snapshot_of(item, fields), fields) for item, fields in before]
        self.record(text, [*others, *tried])

    def add(self, items: Items[Any], *added: Any) -> None:
        """Add objects to the end of a collection of the scene."""
        self.replace(items, (), added)

    def remove(self, *removed: tuple[Items[Any], Sequence[Any]]) -> None:
        """Remove objects from collections of the scene, as one edit."""
        self._do([edit for items, objects in removed for edit in _removals(items, objects)], "removing")

    def replace(self, items: Items[Any], removed: Sequence[Any], added: Sequence[Any], text: str = "") -> None:
        """Remove objects from a collection of the scene, those of `removed` that are there, and add others at its end.
        text: of the edit, by default what it does."""
        edits = _removals(items, removed)
        end = len(items) - len(edits)
        edits += [Presence(items, item, end + number, True) for number, item in enumerate(added)]
        self._do(edits, "adding" if added else "removing", text)

    def _do(self, edits: Sequence[Edit], how: str, text: str = "") -> None:
        edit = edits[0] if len(edits) == 1 and not text else Several(text or f"{how} {len(edits)} objects", edits)
        edit.redo()
        if edits:
            self._append(edit)

    def record(self, text: str, edits: Iterable[Edit]) -> None:
        """Keep what was done already, as one edit."""
        self._append(Several(text, list(edits)))

    def _append(self, edit: Edit) -> None:
        self.done.append(edit)
        if len(self.done) > MOST_EDITS:
            del self.done[:-MOST_EDITS]
            # Without the first edits, undoing all of them doesn't lead back to the file that was opened.
            self._saved = UNREACHABLE if self._saved is None else self._saved
        self.undone.clear()
        self._open = False

    def end_gesture(self) -> None:
        """Let the next assignment be an edit of its own, since the mouse button was released."""
        self._open = False

    def undo(self) -> str:
        """Undo the last edit and return its text, "" if there is none. One that can't be undone is forgotten, and
        raises SolariError."""
        return self._move(self.done, self.undone, "undo")

    def redo(self) -> str:
        """Do the edit again that was undone last, and return its text, "" if there is none. One that can't be done is
        forgotten, and raises SolariError."""
        return self._move(self.undone, self.done, "redo")

    def _move(self, source: list[Edit], target: list[Edit], how: str) -> str:
        self._open = False
        if not source:
            return ""
        # An edit that can't be undone would block all before it for ever, so it is forgotten.
        edit = source.pop()
        try:
            getattr(edit, how)()
        except SolariError as error:
            if source is self.done:
                self._saved = UNREACHABLE  # what the edit did stays
            raise SolariError(f"can't {how} {edit.text}, which is forgotten: {error}") from error
        target.append(edit)
        return edit.text

    def clear(self) -> None:
        """Forget all edits, because another scene is shown."""
        self.done.clear()
        self.undone.clear()
        self._saved = None
        self._open = False

    def __iter__(self) -> Iterator[Edit]:
        """All edits that are done, one by one."""
        return _flat(self.done)


def _removals(items: Items[Any], removed: Sequence[Any]) -> list[Presence]:
    """From the end of the collection on, so that each place is right when the object returns to it."""
    places = {id(item): number for number, item in enumerate(items)}
    at = sorted(((places[id(item)], item) for item in removed if id(item) in places), key=lambda pair: -pair[0])
    return [Presence(items, item, number, False) for number, item in at]


def _all_or_none(edits: Sequence[Edit], how: str, back: str) -> None:
    """Call the method `how` of each, and after an error the method `back` of those before it."""
    done: list[Edit] = []
    try:
        for edit in edits:
            getattr(edit, how)()
            done.append(edit)
    except BaseException:
        _take_back(done, back)
        raise


def _take_back(edits: Sequence[Edit], back: str) -> None:
    """Call the method `back` of each, the last one first. Their errors would hide the one that led here."""
    for edit in reversed(edits):
        with suppress(SolariError):
            getattr(edit, back)()


def _flat(edits: Iterable[Edit]) -> Iterator[Edit]:
    for edit in edits:
        yield from _flat(edit.edits) if isinstance(edit, Several) else [edit]


def _assign(item: Any, values: dict[str, Any], at_once: bool = True) -> None:
    """Objects of the scene take all fields at once, so that those that depend on each other fit."""
    if at_once and isinstance(item, Checked):
        item.update(**values)
        return
    for name, value in values.items():
        setattr(item, name, value)


def _snapshot_of(item: Any, names: Iterable[str]) -> dict[str, Any]:
    """The values of an object's fields, which later edits don't change."""
    values = {name: getattr(item, name) for name in names}
    for name, value in values.items():
        # The arrays of scene objects are read-only already and needn't be copied.
        if isinstance(value, np.ndarray) and value.flags.writeable:
            values[name] = value.copy()
    return values
