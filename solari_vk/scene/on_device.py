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
    watchers = {id(found): found for item in objects for reference in item._watchers if (found := reference())}
    takers = [taker for found in watchers.values() if (taker := getattr(found, "take_all", None)) is not None]
    return next((taken for take in takers if (taken := take(values)) is not None), None)


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
        objects, rows = list(objects), dict[str, Any]()
        for index, item in enumerate(objects):
            if not isinstance(item, cls):
                raise SolariError(f"{cls.__name__}.update_all: object {index} is a {type(item).__name__}")
        for name, values in cls._by_field(fields).items():
            rows[name] = _on_some_device(objects, values)
            if rows[name] is None:
                rows[name] = host_array(values)
            if rows[name].shape[:1] != (len(objects),):
                raise SolariError(
                    f"{cls.__name__}.update_all: {name} must have {len(objects)} rows, one for each "
                    f"object, not the shape {rows[name].shape}"
                )
        on_device = {name for name, given in rows.items() if not isinstance(given, np.ndarray)}
        on_host = dict[str, NDArray[Any]]()  # for objects that no device takes
        for index, item in enumerate(objects):
            own = {name: given.at(index) if name in on_device else given[index] for name, given in rows.items()}
            if on_device and own.keys() <= set(cls._on_device) and item._take(own):
                continue
            on_host = on_host or {name: given.copy() if name in on_device else given for name, given in rows.items()}
            item.update(**{name: given[index] for name, given in on_host.items()})

    def _take(self, fields: Mapping[str, Any]) -> bool:
        """Leave values of fields on a device, or return False."""
        takers = [getattr(reference(), "take", None) for reference in self._watchers]
        taken = next((found for take in takers if take is not None and (found := take(self, fields))), None)
        if taken is None:
            return False
        for name in taken:
            vars(self).pop(name, None)
        object.__setattr__(self, "_given", {**self._given, **taken})
        self._notify(self)
        return True

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
