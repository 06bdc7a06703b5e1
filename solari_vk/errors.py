"""The exceptions of the package. Every mistake of a user, a file or a driver becomes one of them."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

MAX_NAMES = 40  # that a message lists


class SolariError(Exception):
    """Bad input, or a request that can't be fulfilled.

    The message says what was wrong, where (file, node, index, object) and what to do about it.
    """


class DeviceError(SolariError):
    """No suitable device was found, the Vulkan loader is missing, or a device failed (lost, out of memory)."""


class CompilationError(SolariError):
    """A shader has an error; the message quotes the faulty line with its file and number."""


class ValidationError(SolariError):
    """The Vulkan validation layer reported messages, which are the text of the exception."""


class CallbackError(ExceptionGroup[Exception], SolariError):
    """Callbacks of the user raised `exceptions`. The device's state is the same as if they hadn't."""


def unknown_name(what: str, name: object, known: Iterable[str]) -> SolariError:
    """The error for a name that isn't among the known ones: it suggests the closest name and lists all of them.

    what: the start of the message, such as "Material has no field".
    """
    names = list(filter(None, known))
    text = str(name).lower()
    close = difflib.get_close_matches(text, names, 1) or [known for known in names if len(text) > 2 and text in known]
    hint = f"did you mean '{close[0]}'? " if close else ""
    rest = f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else ""
    there = f"there are {', '.join(names[:MAX_NAMES])}{rest}" if names else "there are none"
    return SolariError(f"{what} {name!r}; {hint}{there}")
