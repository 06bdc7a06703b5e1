"""Checks of what users hand in: a wrong kind of thing becomes one clear error where it is given."""

from __future__ import annotations

import operator
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.errors import SolariError

_SHOWN = 60  # characters of a wrong value that a message repeats


def show(value: Any) -> str:
    """A value as messages repeat it: short, and on one line."""
    if isinstance(value, np.ndarray):
        return f"an array {value.shape} of {value.dtype}"
    text = " ".join(repr(value).split())
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


def check_kind(value: Any, kinds: type | tuple[type, ...], what: str, remedy: str) -> None:
    """Raise SolariError unless a value is of one of these types; `remedy` says what is wanted instead."""
    if not isinstance(value, kinds):
        raise SolariError(f"{what} is {show(value)}: {remedy}")


def check_switch(value: Any, what: str) -> None:
    """Raise SolariError unless a value is True or False."""
    check_kind(value, (bool, np.bool_), what, "give True or False")


def whole_number(value: Any, what: str, least: int | None = None) -> int:
    """The value as an int; raises SolariError unless it is one, of numpy's too, and at least `least`."""
    wanted = "a whole number" if least is None else f"a whole number from {least:,} on"
    try:
        number = operator.index(value)
    except TypeError:
        raise SolariError(f"{what} is {show(value)}: give {wanted}") from None
    if isinstance(value, (bool, np.bool_)) or (least is not None and number < least):
        raise SolariError(f"{what} is {show(value)}: give {wanted}")
    return number


def check_whole(array: NDArray[Any], what: str) -> None:
    """Raise SolariError unless an array holds whole numbers; an empty one has no type to speak of."""
    if array.dtype.kind not in "iu" and not (array.size == 0 and array.dtype.kind == "f"):
        raise SolariError(f"{what}, not {array.dtype}")


def numbers(given: Any, what: str) -> NDArray[Any]:
    """As an array of real numbers of the type they come in, or float64; raises SolariError for what are none."""
    try:
        array = np.asarray(given)
        if array.dtype.kind == "O":
            if any(item is None for item in array.flat):
                raise TypeError("None is among them")  # numpy would make NaN of it
            array = array.astype(np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise SolariError(f"{what} are numbers, all rows of them as long as each other: {error}") from error
    if array.dtype.kind not in "fiub":
        raise SolariError(f"{what} are numbers, not {show(given)}")
    return array


def check_items(given: Any, kinds: type | tuple[type, ...], what: str, remedy: str) -> list[Any]:
    """As a list; raises SolariError unless it is iterable and all in it are of one of these types."""
    if isinstance(given, kinds) or not isinstance(given, Iterable):
        raise SolariError(f"{what} are {show(given)}: give a list; {remedy}")
    items = list(given)
    for i, item in enumerate(items):
        check_kind(item, kinds, f"{what}: number {i}", remedy)
    return items
