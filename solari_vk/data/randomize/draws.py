"""Random values as recipes write them: what a value of a recipe may be, and one drawn from it."""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from solari_vk.base.errors import SolariError, quoted, unknown_name

HOW = ("choose", "log")


def stream(seed: int, number: int, place: str) -> np.random.Generator:
    """The random numbers of one value in one picture: others don't change them."""
    # A checksum of the place, and not Python's `hash`, which differs from process to process.
    return np.random.default_rng((seed, number, zlib.crc32(place.encode())))


def check(value: Any, place: str) -> None:
    """Raise SolariError for what no value can be drawn from. place: the file and the keys, for messages."""
    if isinstance(value, Mapping):
        _check_distribution(value, place)
        return
    values = value if isinstance(value, list) else [value]
    is_plain = all(isinstance(one, str | bool) for one in values) and values
    if not (is_plain or value is None or _is_range(value) or is_numbers(value)):
        raise SolariError(
            f"{place}: give a value, two numbers or two vectors from which to which, or "
            f"{{choose: [...]}}, not {quoted(value)}"
        )


def _check_distribution(value: Mapping[Any, Any], place: str) -> None:
    """Raise SolariError for what isn't {choose: [...]} or {log: [low, high]}."""
    for name in value:
        if name not in HOW:
            raise unknown_name(f"{place}: there is no way to draw", name, HOW)
    if len(value) != 1:
        raise SolariError(f"{place}: give one of {' and '.join(HOW)}")
    ((how, argument),) = value.items()
    if how == "choose" and (not isinstance(argument, list) or not argument):
        raise SolariError(f"{place}: choose takes a list of values, not {quoted(argument)}")
    if how == "log" and not (_is_range(argument) and all(np.ravel(argument) > 0)):
        raise SolariError(f"{place}: log takes two numbers above 0, not {quoted(argument)}")


def draw(value: Any, random: np.random.Generator) -> Any:
    """A value from what `check` accepts: itself; of texts one; of [a, b] and [[a, ...], [b, ...]] one between."""
    if isinstance(value, Mapping):
        if "choose" in value:
            return value["choose"][int(random.integers(len(value["choose"])))]
        # The logarithm is uniform: each decade of a range is as likely as the next.
        low, high = (np.log(np.asarray(bound, np.float64)) for bound in value["log"])
        return _plain(np.exp(random.uniform(low, high)))
    if isinstance(value, list) and isinstance(value[0], str):
        return value[int(random.integers(len(value)))]
    if _is_range(value):
        low, high = (np.asarray(bound, np.float64) for bound in value)
        return _plain(random.uniform(low, high))
    return value


def largest(value: Any) -> float:
    """The largest number that `draw` gives; 0 for none."""
    numbers = next(iter(value.values())) if isinstance(value, Mapping) else value
    return float(np.max(numbers)) if is_numbers(numbers) else 0.0


def is_numbers(value: Any) -> bool:
    """Whether it is a finite number, or a list of them."""
    values = value if isinstance(value, list) else [value]
    # In Python a bool is an int, in YAML true is no number.
    numbers = [one for one in values if isinstance(one, int | float) and not isinstance(one, bool)]
    return bool(values) and len(numbers) == len(values) and all(map(math.isfinite, numbers))


def _plain(value: Any) -> Any:
    return float(value) if np.ndim(value) == 0 else value.tolist()


def _is_range(value: Any) -> bool:
    """Whether it is two numbers, or two vectors of one length, lowest first."""
    if not isinstance(value, list) or len(value) != 2 or not all(map(is_numbers, value)):
        return False
    if len({np.shape(bound) for bound in value}) != 1:
        return False
    return bool(np.all(np.asarray(value[0]) <= np.asarray(value[1])))
