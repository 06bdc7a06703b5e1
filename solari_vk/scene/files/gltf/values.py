"""Typed access to a glTF file's JSON: wrong types and ranges become errors that name the place."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

from solari_vk.base import budget
from solari_vk.base.errors import SolariError


class WholeFileError(SolariError):
    """What is wrong with the data of the whole file, such as a buffer that is cut off, and not with one part of it."""


LARGEST_INTEGER = 2**53  # programs that read JSON's numbers as floats of 64 bits represent no larger ones exactly


def shown(value: Any) -> str:
    """Any value for a message: short, on one line."""
    if isinstance(value, (dict, list)):
        return f"{'an object' if isinstance(value, dict) else 'a list'} of {len(value)}"
    # Files of others may hold anything: lone surrogates, line breaks and texts without end.
    text = repr(value) if isinstance(value, str) else str(value)
    text = clean(text).replace("\n", " ")
    return text if len(text) <= 60 else text[:57] + "..."


def clean(text: str) -> str:
    """The text without lone surrogates, so that it can be printed everywhere."""
    return text.encode("utf-8", "replace").decode("utf-8")


class Entry:
    """A JSON object of the file and its place, such as "node 5 'arm'"."""

    __slots__ = ("data", "file", "place")

    def __init__(self, file: str, place: str, data: Any) -> None:
        self.file = file
        self.place = place
        self.data: dict[str, Any] = data
        if not isinstance(data, dict):
            raise self.error(f"is {shown(data)} where the format wants a JSON object")

    def error(self, text: str) -> SolariError:
        """The exception for a fault of this object."""
        return SolariError(f"{self.file}: {self.place} {text}")

    def charge(self, size: int, what: str, *, working: int = 0) -> None:
        """Charge bytes that are about to be allocated for this object; see `budget.charge`."""
        budget.charge(size, f"{self.file}: {self.place}", what, working=working)

    def wrong(self, key: str, wanted: str) -> SolariError:
        """The exception for a field with a value the format does not allow."""
        found = f"is {shown(self.data[key])}" if key in self.data else "is missing"
        return self.error(f"has a wrong field: '{key}' {found}, but must be {wanted}; export the file again")

    def __contains__(self, key: str) -> bool:
        return key in self.data

    @property
    def name(self) -> str:
        """The name of the object, empty if it has none."""
        return self.text("name", "")

    def integer(self, key: str, default: int | None = None, *, low: int = 0, high: int = LARGEST_INTEGER) -> int:
        """A whole number in a range; without a default the field is required."""
        value = whole(self.data.get(key, default))
        if value is None or not low <= value <= high:
            bounds = f" from {low}" + (f" to {high}" if high != LARGEST_INTEGER else "")
            raise self.wrong(key, f"a whole number{bounds}")
        return value

    def index(self, key: str) -> int | None:
        """The index of another object, or None if the field is absent."""
        return self.integer(key) if key in self.data else None

    def number(
        self, key: str, default: float | None = None, *, low: float = -math.inf, high: float = math.inf
    ) -> float:
        """A finite number in a range; without a default the field is required."""
        value = _within(self.data.get(key, default), low, high)
        if value is None:
            raise self.wrong(key, f"a finite number{_bounds(low, high)}")
        return value

    def limited(self, key: str, default: float | None = None, *, low: float = -math.inf, limit: float) -> float:
        """A finite number for which glTF has no maximum, such as the largest float for "no limit"; above the limit of
        the scene's objects it becomes that, and likewise below its negative."""
        return min(max(self.number(key, default, low=low), -limit), limit)

    def numbers(
        self, key: str, default: tuple[float, ...], *, low: float = -math.inf, high: float = math.inf
    ) -> tuple[float, ...]:
        """As many finite numbers as the default has."""
        if key not in self.data:
            return default
        listed = self.data[key]
        if isinstance(listed, list) and len(listed) == len(default):
            numbers = [_within(value, low, high) for value in listed]
            fitting = tuple(number for number in numbers if number is not None)
            if len(fitting) == len(default):
                return fitting
        raise self.wrong(key, f"a list of {len(default)} finite numbers{_bounds(low, high)}")

    def values(self, key: str, wanted: str, fits: Callable[[Any], bool] | None = None) -> list[Any]:
        """A list whose values all fit, empty when the field is absent. wanted: names the values in the error."""
        listed = self.data.get(key, [])
        if not isinstance(listed, list) or (fits is not None and not all(map(fits, listed))):
            raise self.wrong(key, f"a list of {wanted}")
        return listed

    def integers(self, key: str) -> list[int]:
        """A list of whole numbers from 0, empty when the field is absent."""
        return [int(value) for value in self.values(key, "whole numbers from 0", is_index)]

    def text(self, key: str, default: str | None = None, choices: tuple[str, ...] = ()) -> str:
        """A string; without a default the field is required."""
        value = self.data.get(key, default)
        if not isinstance(value, str) or (choices and value not in choices):
            raise self.wrong(key, f"one of {', '.join(choices)}" if choices else "a text")
        return clean(value)

    def flag(self, key: str, default: bool) -> bool:
        """A field that is true or false."""
        value = self.data.get(key, default)
        if not isinstance(value, bool):
            raise self.wrong(key, "true or false")
        return value

    def texts(self, key: str) -> list[str]:
        """A list of strings, empty when the field is absent."""
        return [clean(value) for value in self.values(key, "texts", lambda value: isinstance(value, str))]

    def entry(self, key: str) -> Entry | None:
        """An object inside this one, or None when the field is absent."""
        if key not in self.data:
            return None
        # An AnimatedEntry has animated entries in it.
        return type(self)(self.file, f"{self.place}, {clean(key)}", self.data[key])

    def entries(self, key: str, kind: str) -> list[Entry]:
        """The objects of a list inside this one, empty when the field is absent."""
        objects = self.values(key, "objects")
        return [Entry(self.file, f"{self.place}, {kind} {number}", value) for number, value in enumerate(objects)]

    def extension(self, name: str) -> Entry | None:
        """The data of an extension for this object, or None."""
        extensions = self.entry("extensions")
        return extensions.entry(name) if extensions else None

    def extensions(self) -> Iterator[str]:
        """The names of the extensions with data for this object."""
        extensions = self.entry("extensions")
        if extensions:
            yield from map(clean, extensions.data)


def whole(value: Any) -> int | None:
    """The whole number that a value of the JSON is, also when it is written as a float such as 3.0; else None."""
    if isinstance(value, float) and value.is_integer():
        return int(value)
    return value if isinstance(value, int) and not isinstance(value, bool) else None


def is_index(value: Any) -> bool:
    """Whether a value of the JSON is a whole number from 0."""
    number = whole(value)
    return number is not None and number >= 0


def _bounds(low: float, high: float) -> str:
    return (f" from {low:g}" if low > -math.inf else "") + (f" to {high:g}" if high < math.inf else "")


def _within(value: Any, low: float, high: float) -> float | None:
    """The finite number if it lies in the range, else None; rounding errors of exporters are tolerated."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    # 1.0000001 for a factor of at most 1 is a rounding error of an exporter, and becomes 1.
    if not math.isfinite(number) or not low - 1e-6 <= number <= high + 1e-6:
        return None
    return min(max(number, low), high)
