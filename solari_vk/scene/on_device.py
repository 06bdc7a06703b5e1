"""Objects of which tensors give some fields in memory of a device, where the host reads them only if it must."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.base.host_array import host_array
from solari_vk.scene.observed import Checked


class DeviceArray(Protocol):
    """Numbers in memory of a device."""

    shape: tuple[int, ...]

    def copy(self) -> NDArray[Any]:
        """The numbers in the host's memory."""

    def at(self, index: int) -> DeviceArray:
        """A row."""


def _on_some_device(objects: Sequence[Any], values: Any) -> DeviceArray | None:
    """A tensor on the device of a watcher of objects; None for what the host must read."""
    watchers: dict[int, Any] = {}
    for item in objects:
        watchers |= {id(watcher): watcher for watcher in item._alive_watchers()}
    for watcher in watchers.values():
        take_all = getattr(watcher, "take_all", None)
        taken: DeviceArray | None = None if take_all is None else take_all(values)
        if taken is not None:
            return taken
    return None


def _is_on_device(values: Any) -> bool:
    return not isinstance(values, np.ndarray)


def _row(values: Any, index: int) -> Any:
    return values.at(index) if _is_on_device(values) else values[index]


class OnDevice(Checked):
    """Tensors that are assigned to the fields `_on_device` stay on the device of a watcher whose `take` takes them. In
    place of these fields `__getattr__` finds what a tensor gave."""

    _given: ClassVar[Mapping[str, DeviceArray]] = {}  # by field: what a tensor gave
    _host_edits: ClassVar[int] = 0  # assignments that no device took

    def update(self, **fields: Any) -> None:
        """As of the other objects. Tensors stay on the device that takes them."""
        fields = self._by_field(fields, self)
        if self._ready and fields and fields.keys() <= set(self._on_device) and self._take(fields):
            return
        super().update(**fields)
        if self._ready:
            object.__setattr__(self, "_host_edits", self._host_edits + 1)
        if self._given:
            object.__setattr__(self, "_given", {n: given for n, given in self._given.items() if n not in fields})

    @classmethod
    def update_all(cls, objects: Iterable[Any], **fields: Any) -> None:
        """Assign fields of several objects at once: row i of each array or tensor is of object i, such as
        `Material.update_all(materials, base_color=colors)` with colors (N, 3). Of a tensor of a GPU one copy
        serves all. Raises SolariError for another number of rows, and at the first object that refuses its row.
        """
        objects = list(objects)
        for index, item in enumerate(objects):
            if not isinstance(item, cls):
                raise SolariError(f"{cls.__name__}.update_all: object {index} is a {type(item).__name__}")
        rows = {name: cls._rows(objects, name, values) for name, values in cls._by_field(fields).items()}
        may_stay = rows.keys() <= set(cls._on_device) and any(map(_is_on_device, rows.values()))
        on_host: dict[str, NDArray[Any]] = {}  # copied once, when the first object needs it
        for index, item in enumerate(objects):
            if may_stay and item._take({name: _row(values, index) for name, values in rows.items()}):
                continue
            if not on_host:
                on_host = {name: values.copy() if _is_on_device(values) else values for name, values in rows.items()}
            item.update(**{name: values[index] for name, values in on_host.items()})

    @classmethod
    def _rows(cls, objects: Sequence[Any], name: str, values: Any) -> Any:
        """The values of a field of all objects, on the device of one of their watchers or on the host."""
        rows: Any = _on_some_device(objects, values)
        if rows is None:
            rows = host_array(values)
        if rows.shape[:1] != (len(objects),):
            raise SolariError(
                f"{cls.__name__}.update_all: {name} must have {len(objects)} rows, one for each "
                f"object, not the shape {rows.shape}"
            )
        return rows

    def _take(self, fields: Mapping[str, Any]) -> bool:
        """Leave values of fields on a device, or return False."""
        for watcher in self._alive_watchers():
            take = getattr(watcher, "take", None)
            taken = None if take is None else take(self, fields)
            if not taken:
                continue
            # From now on `__getattr__` finds these fields, and copies them only if the host reads them.
            for name in taken:
                vars(self).pop(name, None)
            object.__setattr__(self, "_given", {**self._given, **taken})
            self._notify(self)
            return True
        return False

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """What a tensor gave, in the host's memory."""
            if name not in self._on_device or name not in self._given:
                return super().__getattr__(name)
            try:
                value = self._converters[name](self._given[name].copy())
            except ValueError as error:
                raise SolariError(f"{self.describe()}: {name} {error}: a tensor gave them") from None
            object.__setattr__(self, name, value)
            return value

    def _held(self, name: str) -> Any:
        """A field as it was given: a value, or what a device took of a tensor."""
        return self._given[name] if name in self._given else getattr(self, name)

    def __getstate__(self) -> dict[str, Any]:
        on_host = {name: getattr(self, name) for name in self._given}
        return {name: value for name, value in (super().__getstate__() | on_host).items() if name != "_given"}
