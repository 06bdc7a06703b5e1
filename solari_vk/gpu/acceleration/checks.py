"""Checks of arguments: a value of the wrong type or range raises one clear error where it is passed."""

from __future__ import annotations

import operator
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.base.host_array import host_array

_SHOWN = 60  # maximum number of characters of a value in a message


def show(value: Any) -> str:
    """A value as shown in messages: short, and on one line."""
    if isinstance(value, np.ndarray):
        return f"an array {value.shape} of {value.dtype}"
    text = " ".join(repr(value).split())
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


def check_kind(value: Any, kinds: type | tuple[type, ...], what: str, remedy: str) -> None:
    """Raise SolariError unless a value has one of these types; `remedy` says what to pass instead."""
    if not isinstance(value, kinds):
        raise SolariError(f"{what} is {show(value)}: {remedy}")


def check_switch(value: Any, what: str) -> None:
    """Raise SolariError unless a value is True or False."""
    check_kind(value, (bool, np.bool_), what, "give True or False")


def whole_number(value: Any, what: str, minimum: int | None = None) -> int:
    """The value as an int; raises SolariError unless it is an integer of Python or numpy, and at least `minimum`."""
    wanted = "a whole number" if minimum is None else f"a whole number, at least {minimum:,}"
    try:
        number = operator.index(value)
    except TypeError:
        raise SolariError(f"{what} is {show(value)}: give {wanted}") from None
    if isinstance(value, (bool, np.bool_)) or (minimum is not None and number < minimum):
        raise SolariError(f"{what} is {show(value)}: give {wanted}")
    return number


def check_whole(array: NDArray[Any], what: str) -> None:
    """Raise SolariError unless an array holds whole numbers. An empty array of floats is accepted."""
    if array.dtype.kind not in "iu" and not (array.size == 0 and array.dtype.kind == "f"):
        raise SolariError(f"{what}, not {array.dtype}")


def numbers(values: Any, what: str) -> NDArray[Any]:
    """The values as an array of their own type, or float64; raises SolariError unless they are real numbers."""
    try:
        array = host_array(values)
        if array.dtype.kind == "O":
            if any(item is None for item in array.flat):
                raise TypeError("None is not a number")  # numpy would convert it to NaN
            array = array.astype(np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise SolariError(f"{what} must be numbers in rows of equal length: {error}") from error
    if array.dtype.kind not in "fiub":
        raise SolariError(f"{what} must be numbers, not {show(values)}")
    return array


def check_items(value: Any, kinds: type | tuple[type, ...], what: str, remedy: str) -> list[Any]:
    """The items as a list; raises SolariError unless `value` is iterable and all items have one of these types."""
    if isinstance(value, kinds) or not isinstance(value, Iterable):
        raise SolariError(f"{what} are {show(value)}: give a list; {remedy}")
    items = list(value)
    for i, item in enumerate(items):
        check_kind(item, kinds, f"{what}: number {i}", remedy)
    return items
