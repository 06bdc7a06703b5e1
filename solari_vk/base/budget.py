"""What loading a file may take, in memory and time. Whoever allocates for a file charges it first."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from numbers import Integral, Real

import numpy as np

from solari_vk.base.errors import SolariError, quoted

MEMORY = 2 * 2**30
SECONDS = 600.0
_UNITS = {"": 1, "b": 1, "kb": 10**3, "mb": 10**6, "gb": 10**9, "kib": 2**10, "mib": 2**20, "gib": 2**30}
_SURROGATE = re.compile(rb"\\u[dD][89aAbB]")
_current: ContextVar[Budget | None] = ContextVar("budget", default=None)


class BudgetError(SolariError):
    """What is loaded needs more memory or time than it may take."""


@dataclass
class Budget:
    """The bytes and the time of `time.monotonic()` up to which a file may be loaded, the bytes charged so far, and the
    most that were needed at a time."""

    memory: int
    end: float
    charged: int = field(default=0, init=False)
    peak: int = field(default=0, init=False)


@contextmanager
def load_budget(memory: int | None = None, seconds: float | None = None) -> Iterator[Budget]:
    """Charges within this context count together; within another such context they count there.

    memory: bytes, by default those of the environment variable SOLARI_VK_LOAD_MEMORY ("4GiB"), else 2 GiB. seconds: by
    default SOLARI_VK_LOAD_SECONDS, else 600. Raises SolariError for what is no size or time.
    """
    # What a file refers to, such as images, is part of its budget.
    outer = _current.get()
    if outer is not None:
        yield outer
        return
    if memory is None:
        memory = parse_size(os.environ.get("SOLARI_VK_LOAD_MEMORY", str(MEMORY)), "SOLARI_VK_LOAD_MEMORY")
    if seconds is None:
        seconds = _parse_seconds(os.environ.get("SOLARI_VK_LOAD_SECONDS", str(SECONDS)))
    if not (isinstance(memory, Integral) and isinstance(seconds, Real) and memory > 0 and seconds > 0):
        given = f"{quoted(memory)} and {quoted(seconds)}"
        raise SolariError(f"load: give memory in bytes and seconds, both above 0, not {given}")
    budget = Budget(int(memory), time.monotonic() + float(seconds))
    token = _current.set(budget)
    try:
        yield budget
    finally:
        _current.reset(token)


def charge(size: int, who: str, what: str, *, working: int = 0) -> None:
    """Charge bytes before they are allocated. who: the file and what in it is large; what: what the bytes are for.

    working: bytes that are needed beside for a moment. Raises BudgetError above the budget, of memory or of time.
    Without a budget nothing is charged.
    """
    budget = _current.get()
    if budget is None:
        return
    if budget.charged + size + working > budget.memory:
        raise BudgetError(
            f"{who}: {what} would take {(size + working) / 2**20:,.0f} MiB, and with what was loaded before more than "
            f"the {budget.memory / 2**20:,.0f} MiB that loading may take: give load(memory=bytes) or set "
            "SOLARI_VK_LOAD_MEMORY, such as 8GiB, if you trust the file"
        )
    # `working` isn't added to what is charged: it is free again before the next charge.
    budget.peak = max(budget.peak, budget.charged + size + working)
    budget.charged += size
    if time.monotonic() > budget.end:
        raise BudgetError(
            f"{who}: loading takes longer than it may: give load(seconds=...) or set SOLARI_VK_LOAD_SECONDS if you "
            "trust the file"
        )


def string_bytes(text: bytes) -> int:
    """The bytes that UTF-8 takes as a Python string: one character above U+FFFF makes all of them take four each.

    Where JSON's escapes may name such a character they count too."""
    # 0xC4 is the lead byte of U+0100, and 0xF0 that of U+10000.
    highest = 0 if text.isascii() else int(np.frombuffer(text, np.uint8).max())
    if highest >= 0xF0 or _SURROGATE.search(text):
        return 4 * len(text)
    if highest >= 0xC4 or b"\\u" in text:
        return 2 * len(text)
    return len(text)


def parse_size(text: str, name: str) -> int:
    """Bytes from a number with a unit, such as "4GiB", "500 MB" or "1000000". name: what has the value, for errors."""
    found = re.fullmatch(r"\s*(\d{1,15}(?:\.\d{1,9})?)\s*([kmg]i?b|b|)\s*", text, re.IGNORECASE)
    if found is None or float(found[1]) <= 0:
        raise SolariError(f"{name}: give a size such as 4GiB, not {text[:40]!r}")
    return int(float(found[1]) * _UNITS[found[2].lower()])


def _parse_seconds(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise SolariError(f"SOLARI_VK_LOAD_SECONDS: give a number of seconds, not {text[:40]!r}") from None
