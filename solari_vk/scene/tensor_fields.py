"""Objects of which some fields may be tensors in memory of a device, which the host reads only if it must."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.base.host_array import host_array
from solari_vk.scene.observable import Checked


class Tensor(Protocol):
    """Numbers in memory of a device."""

    shape: tuple[int, ...]

    def read(self) -> NDArray[Any]:
        """The numbers in the host's memory."""

    def at(self, index: int) -> Tensor:
        """A row."""


def _accepted_by_some_device(objects: Sequence[Any], values: Any) -> Tensor | None:
    """A tensor on the device of a watcher of objects; None for what the host must read."""
    watchers: dict[int, Any] = {}  # each once: many objects have the same ones
    for item in objects:
        watchers |= {id(watcher): watcher for watcher in item._alive_watchers()}
    for watcher in watchers.values():
        accept = getattr(watcher, "accept_tensor", None)
        tensor: Tensor | None = None if accept is None else accept(values)
        if tensor is not None:
            return tensor
    return None


class TensorFields(Checked):
    """Tensors that are assigned to the fields `_tensor_fields` stay on the device of a watcher that accepts them.

    The object then has the tensor in `_tensors` in place of the field, which `__getattr__` reads from it when somebody
    asks the host for the field.
    """

    _tensors: ClassVar[Mapping[str, Tensor]] = {}  # by field
    _host_edits: ClassVar[int] = 0  # assignments that no device accepted

    def update(self, **fields: Any) -> None:
        """As of the other objects. Tensors stay on the device that accepts them."""
        fields = self._by_field(fields, self)
        if self._ready and fields and fields.keys() <= set(self._tensor_fields) and self._accept_tensors(fields):
            return
        super().update(**fields)
        if self._ready:
            object.__setattr__(self, "_host_edits", self._host_edits + 1)
        if self._tensors:
            left = {name: tensor for name, tensor in self._tensors.items() if name not in fields}
            object.__setattr__(self, "_tensors", left)

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
        arrays: dict[str, NDArray[Any]] = {}
        tensors: dict[str, Tensor] = {}
        for name, values in cls._by_field(fields).items():
            tensor = _accepted_by_some_device(objects, values)
            if tensor is not None:
                tensors[name] = tensor
            else:
                arrays[name] = host_array(values)
        for name, rows in (arrays | tensors).items():
            if rows.shape[:1] != (len(objects),):
                raise SolariError(
                    f"{cls.__name__}.update_all: {name} must have {len(objects)} rows, one for each "
                    f"object, not the shape {rows.shape}"
                )
        may_stay = not arrays and tensors.keys() <= set(cls._tensor_fields)
        for index, item in enumerate(objects):
            if may_stay and item._accept_tensors({name: tensor.at(index) for name, tensor in tensors.items()}):
                continue
            # No device accepts them for this object: the host reads each tensor once, for all such objects.
            for name in tensors.keys() - arrays.keys():
                arrays[name] = tensors[name].read()
            item.update(**{name: rows[index] for name, rows in arrays.items()})

    def _accept_tensors(self, fields: Mapping[str, Any]) -> bool:
        """Leave values of fields on the device of a watcher, or return False."""
        for watcher in self._alive_watchers():
            accept = getattr(watcher, "accept_tensors", None)
            tensors = None if accept is None else accept(self, fields)
            if tensors is None:
                continue
            # From now on `__getattr__` finds these fields, and reads them only if the host asks.
            for name in tensors:
                vars(self).pop(name, None)
            object.__setattr__(self, "_tensors", {**self._tensors, **tensors})
            self._notify(self)
            return True
        return False

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """The numbers of a tensor in the host's memory, which are checked as any others."""
            if name not in self._tensor_fields or name not in self._tensors:
                return super().__getattr__(name)
            try:
                value = self._converters[name](self._tensors[name].read())
            except ValueError as error:
                raise SolariError(f"{self.describe()}: {name} {error}: a tensor gave them") from None
            object.__setattr__(self, name, value)
            return value

    def _stored(self, name: str) -> Any:
        """A field where it is: a value, or a tensor, which isn't read."""
        return self._tensors[name] if name in self._tensors else getattr(self, name)

    def __getstate__(self) -> dict[str, Any]:
        on_host = {name: getattr(self, name) for name in self._tensors}
        return {name: value for name, value in (super().__getstate__() | on_host).items() if name != "_tensors"}
