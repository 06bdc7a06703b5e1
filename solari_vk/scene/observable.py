"""Objects that check what is assigned to their fields, and notify watchers of changes."""

from __future__ import annotations

import functools
import inspect
import operator
import weakref
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field, fields
from typing import Any, ClassVar, Protocol, TypeVar, dataclass_transform

import numpy as np

from solari_vk.base.errors import Hints, SolariError, check_count, shortened, unknown_name

# No picture depends on these fields: assigning them costs no work on the device.
_UNSEEN = {"name", "label", "part_of"}


class Watcher(Protocol):
    """Is notified of every object that has changed."""

    def mark_changed(self, changed: Observable) -> None: ...


class Observable(Hints):
    """Notifies its watchers of changes. It holds only weak references to them."""

    _watchers: tuple[weakref.ref[Watcher], ...] = ()

    def watch(self, watcher: Watcher) -> None:
        """Have `watcher.mark_changed(self)` called on every change, for as long as the watcher lives."""
        self.unwatch(watcher)
        # Past our own __setattr__, which is for fields.
        object.__setattr__(self, "_watchers", (*self._watchers, weakref.ref(watcher)))

    def unwatch(self, watcher: Watcher) -> None:
        """Stop notifying a watcher."""
        others = tuple(weakref.ref(other) for other in self._alive_watchers() if other is not watcher)
        object.__setattr__(self, "_watchers", others)

    def _alive_watchers(self) -> list[Watcher]:
        """The watchers that haven't been deleted."""
        watchers = [reference() for reference in self._watchers]
        return [watcher for watcher in watchers if watcher is not None]

    def __getstate__(self) -> dict[str, Any]:
        """For copies: they have no watchers, such as a renderer's binder, which know the original only."""
        return {name: value for name, value in self.__dict__.items() if name != "_watchers"}

    def _notify(self, changed: Observable) -> None:
        for watcher in self._alive_watchers():
            watcher.mark_changed(changed)

    def describe(self) -> str:
        """The object's kind and name, for messages."""
        name = getattr(self, "name", "")
        return f"{type(self).__name__} '{shortened(name)}'" if name else type(self).__name__


def _shown(value: Any) -> str:
    """A field's value in a few words: the name of an object, where a transform moves to, the shape of a large array."""
    if isinstance(value, Observable):
        return value.describe()
    if isinstance(value, np.ndarray):
        if value.shape == (4, 4):
            x, y, z = value[:3, 3]
            return f"<to ({x:.4g}, {y:.4g}, {z:.4g})>"
        if value.dtype.kind == "f" and value.size <= 4:
            return f"({', '.join(f'{number:.4g}' for number in value.flat)})"
        return str(value.tolist()) if value.size <= 4 else f"array{value.shape}"
    return repr(value)


def _equal(value: Any, default: Any) -> bool:
    if isinstance(value, np.ndarray):
        return isinstance(default, np.ndarray) and np.array_equal(value, default)
    return bool(value is default or (type(value) is type(default) and value == default))


class Checked(Observable):
    """A dataclass whose fields are checked when assigned. Subclasses are made by the decorator `checked`."""

    _converters: ClassVar[Mapping[str, Callable[[Any], Any]]] = {}  # and those in the fields' metadata
    _aliases: ClassVar[Mapping[str, str]] = {}  # other names of fields
    _names: ClassVar[Mapping[str, None]] = {}  # the fields, in order; `checked` sets it
    _derived: ClassVar[tuple[str, ...]] = ()  # names that can be assigned, of which `_resolve` makes fields
    _defaults: ClassVar[Mapping[str, Any]] = {}  # of the fields; MISSING where there is none; `checked` sets it
    _tensor_fields: ClassVar[tuple[str, ...]] = ()  # may be tensors on a device: see TensorFields
    _ready = False
    name: str

    def __post_init__(self) -> None:
        self._validate()
        object.__setattr__(self, "_ready", True)

    def __setattr__(self, name: str, value: Any) -> None:
        self.update(**{name: value})

    def update(self, **fields: Any) -> None:
        """Assign several fields at once; nothing is changed if one of them is refused."""
        converted = self._converted(self._by_field(fields, self))
        before = {name: vars(self).get(name, MISSING) for name in converted} if self._ready else {}
        for name, value in converted.items():
            object.__setattr__(self, name, value)
        # The constructor assigns field by field, and validates when it has all of them.
        if not self._ready:
            return
        try:
            self._validate()
        except SolariError:
            self._restore(before)
            raise
        if not converted.keys() <= _UNSEEN:
            self._notify(self)

    def _converted(self, fields: dict[str, Any]) -> dict[str, Any]:
        """The values of fields as they are stored. Raises SolariError for a value that a field can't have."""
        converted = {}
        for name, value in fields.items():
            try:
                converted[name] = self._converters[name](value) if name in self._converters else value
            except (TypeError, ValueError, OverflowError) as error:
                raise SolariError(f"{self.describe()}: {name} {error}") from None
        return converted

    def _restore(self, before: dict[str, Any]) -> None:
        """Assign former values without checks. MISSING: the object had none, since a device has the field."""
        for name, value in before.items():
            if value is MISSING:
                vars(self).pop(name)
            else:
                object.__setattr__(self, name, value)

    @classmethod
    def _by_field(cls, arguments: dict[str, Any], current: Checked | None = None) -> dict[str, Any]:
        """Replace aliases and derived names by the fields' names. Raises SolariError for an unknown name, and for a
        field given twice. current: the object that is changed, None for one that is made."""
        # The usual case, first: objects of large scenes are made with the fields' own names.
        if arguments.keys() <= cls._names.keys():
            return arguments
        names: dict[str, str] = {}  # by field: the name that the caller used
        for name in arguments:
            field = cls._aliases.get(name, name)
            if field not in cls._names and field not in cls._derived:
                raise unknown_name(f"{cls.__name__} has no field", name, [*cls._names, *cls._aliases, *cls._derived])
            if field in names:
                raise SolariError(f"{cls.__name__}: {names[field]} and {name} name the same field: give one of them")
            names[field] = name
        fields = {field: arguments[name] for field, name in names.items()}
        return fields if fields.keys().isdisjoint(cls._derived) else cls._resolve(fields, current)

    @classmethod
    def _resolve(cls, fields: dict[str, Any], current: Any) -> dict[str, Any]:
        """The fields that fields and derived names mean. current: as of `_by_field`."""
        raise NotImplementedError

    def __repr__(self) -> str:
        """The fields that aren't as by default."""
        values = {name: getattr(self, name) for name in self._names}
        shown = (f"{name}={_shown(value)}" for name, value in values.items() if not _equal(value, self._defaults[name]))
        return f"{type(self).__name__}({', '.join(shown)})"

    def _validate(self) -> None:
        """Raise SolariError if fields don't fit together."""


Kind = TypeVar("Kind", bound=type[Checked])


@dataclass_transform(eq_default=False, field_specifiers=(field,))
def checked(kind: Kind) -> Kind:
    """Make a subclass of Checked a dataclass, compared by identity, whose constructor takes aliases of fields too."""
    dataclass(eq=False, repr=False)(kind)
    metadata = {field.name: field.metadata for field in fields(kind)}  # type: ignore[arg-type]
    kind._names = dict.fromkeys(metadata)
    kind._defaults = {
        field.name: field.default if field.default_factory is MISSING else field.default_factory()
        for field in fields(kind)  # type: ignore[arg-type]
    }
    converters = {name: entry["converter"] for name, entry in metadata.items() if "converter" in entry}
    kind._converters = converters | dict(kind._converters)
    init: Callable[..., None] = kind.__init__
    in_order = [field.name for field in fields(kind) if field.init and not field.kw_only]  # type: ignore[arg-type]

    @functools.wraps(init)
    def with_aliases(self: Checked, *values: Any, **fields: Any) -> None:
        check_count(type(self).__name__, "", values, in_order, self._names)
        init(self, *values, **type(self)._by_field(fields))

    with_aliases.__signature__ = _with_defaults(init, kind._defaults)  # type: ignore[attr-defined]
    # The dataclass makes its constructor before; now it also takes other names.
    setattr(kind, "__init__", with_aliases)  # noqa: B010
    for name in vars(kind).keys() & set(kind._tensor_fields):
        # Or __getattr__, which finds tensors, would not be asked.
        delattr(kind, name)  # the default
    for alias, name in kind._aliases.items():
        setattr(kind, alias, property(operator.attrgetter(name), doc=f"Another name of `{name}`."))
    return kind


class _Default:
    """A default of a constructor as `help` shows it, in place of "<factory>"."""

    def __init__(self, value: Any) -> None:
        self._value = value

    def __repr__(self) -> str:
        return _shown(self._value)


def _with_defaults(init: Callable[..., None], defaults: Mapping[str, Any]) -> inspect.Signature:
    """A constructor's signature with the values that the factories of its fields make."""
    signature = inspect.signature(init)
    shown = [
        one.replace(default=_Default(defaults[one.name])) if repr(one.default) == "<factory>" else one
        for one in signature.parameters.values()
    ]
    return signature.replace(parameters=shown)
