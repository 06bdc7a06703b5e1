"""The exceptions of the package. Every mistake of a user, a file or a driver becomes one of them."""

from __future__ import annotations

import difflib
import functools
import inspect
import re
import sys
import warnings
from abc import ABCMeta
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, NoReturn, ParamSpec, TypeVar

from solari_vk.base.other_words import advice_for

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")

MAX_NAMES = 16  # that a message lists; of more it lists the NEAREST to what was given
NEAREST = 5
MAX_VALUE = 80  # characters of a value that a message quotes
MAX_LINE = 2000
_LONG_WORD = re.compile(r"[^\s/\\]{300,}")  # no file has so long a name
_LONG_LINE = re.compile(rf"[^\n]{{{MAX_LINE + 1},}}")


def shortened(text: str, most: int = MAX_VALUE) -> str:
    """A text of at most `most` characters: of a longer one the middle is left out."""
    return text if len(text) <= most else f"{text[: most - 20]}...{text[-17:]}"


def quoted(value: object) -> str:
    """A value as Python writes it, shortened, for messages."""
    try:
        return shortened(repr(value))
    except Exception:  # of an integer with thousands of digits, or by a class of the user
        return f"a value of the type {type(value).__name__}"


def brief(text: str) -> str:
    """A message whose words and lines aren't longer than somebody reads, whatever it quotes."""
    text = _LONG_WORD.sub(lambda word: shortened(word[0]), text)
    return _LONG_LINE.sub(lambda line: shortened(line[0], MAX_LINE), text)


class SolariError(Exception):
    """Bad input, or a request that can't be fulfilled.

    The message says what was wrong, where (file, node, index, object) and what to do about it.
    """

    def __str__(self) -> str:
        return brief(super().__str__())


class DeviceError(SolariError):
    """No suitable device was found, the Vulkan loader is missing, or a device failed (lost, out of memory)."""


class CompilationError(SolariError):
    """A shader has an error; the message quotes the faulty line with its file and number."""


class ValidationError(SolariError):
    """The Vulkan validation layer reported messages, which are the text of the exception."""


class CallbackError(ExceptionGroup[Exception], SolariError):
    """Callbacks of the user raised `exceptions`. The device's state is the same as if they hadn't."""


def unknown_name(what: str, name: object, known: Iterable[str]) -> SolariError:
    """The error for a name that isn't among the known ones: it says what another program's word is called here;
    otherwise it suggests the closest name, and lists a few names, or of many the nearest.

    what: the start of the message, such as "Material has no field".
    """
    if isinstance(name, str) and (advice := advice_for(what, name.lower())):
        return SolariError(f"{what} {quoted(name)}: {advice}")
    names = list(dict.fromkeys(filter(None, known)))
    text = (name if isinstance(name, str) else quoted(name))[:MAX_VALUE].lower()
    lower = {known.lower(): known for known in reversed(names)}
    start = [known for known in lower if text.startswith(f"{known}_")]  # such as `add` for add_light
    part = [known for known in lower if len(text) > 2 and (text in known or (len(known) > 2 and known in text))]
    near = difflib.get_close_matches
    close = [lower[known] for known in near(text, lower, 1, 0.8) or start or near(text, lower, 1) or part]
    hint = f"did you mean '{close[0]}'? " if close else ""
    if len(names) <= MAX_NAMES:
        there = f"there are {', '.join(names)}" if names else "there are none"
    else:
        nearest = dict.fromkeys([*close, *(lower[known] for known in near(text, lower, NEAREST, 0.0))])
        there = f"the nearest of {len(names)} are {', '.join(list(nearest)[:NEAREST])}"
    return SolariError(f"{what} {quoted(name)}; {hint}{there}")


def unknown_attribute(what: str, name: str, known: Callable[[], Iterable[str]]) -> AttributeError:
    """As `unknown_name`, of the type that Python expects where attributes are looked up; private names get no hint."""
    if name.startswith("_"):
        return AttributeError(f"{what} '{name}'")
    return AttributeError(str(unknown_name(what, name, (name for name in known() if not name.startswith("_")))))


class _Hinting(ABCMeta):
    if not TYPE_CHECKING:  # or checkers would take any name

        def __getattr__(cls, name: str) -> NoReturn:
            raise unknown_attribute(f"{cls.__name__} has no attribute", name, lambda: type.__dir__(cls))


class Hints(metaclass=_Hinting):
    """Names the nearest attributes of an object, or of its class, when it is asked for one that it hasn't."""

    __slots__ = ()

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> NoReturn:
            raise unknown_attribute(f"{type(self).__name__} has no attribute", name, lambda: object.__dir__(self))


def checked_keywords(
    hint: str = "", who: str = ""
) -> Callable[[Callable[Parameters, Result]], Callable[Parameters, Result]]:
    """A decorator of methods, and with `who` of functions: an unknown keyword raises the error of `unknown_name`, with
    a hint at its end; more values than the parameters that take them, and too few, errors that list these. who: the
    function's module, for messages."""

    def decorate(method: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
        parameters = list(inspect.signature(method).parameters.values())[not who :]
        known = [p.name for p in parameters if p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)]
        in_order = [p.name for p in parameters if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)]
        takes_any = any(p.kind == p.VAR_POSITIONAL for p in parameters)
        needed = [p.name for p in parameters if p.default is p.empty and p.name in known]
        of = "" if method.__name__ == "__init__" else f".{method.__name__}"

        @functools.wraps(method)
        def checked(*given: Parameters.args, **options: Parameters.kwargs) -> Result:
            for name in options:
                if name not in known:
                    owner = f"{who or type(given[0]).__name__}{of}"
                    error = unknown_name(f"{owner} has no option", name, known)
                    raise SolariError(f"{error}{hint and f'; {hint}'}")
            if not takes_any:
                check_count(who or type(given[0]).__name__, of, given[not who :], in_order, known)
            if missing := [name for name in needed if name not in {*in_order[: len(given[not who :])], *options}]:
                raise SolariError(
                    f"{who or type(given[0]).__name__}{of} needs {', '.join(missing)}: it takes ({', '.join(known)})"
                )
            return method(*given, **options)

        return checked

    return decorate


def check_count(
    owner: str, method: str, values: Sequence[object], in_order: Sequence[str], known: Iterable[str]
) -> None:
    """Raise SolariError for more values than the parameters `in_order`, the only ones that are given without names."""
    if len(values) > len(in_order):
        named = shortened(", ".join(f"{name}=" for name in known if name not in in_order))
        pair = "; the size is one pair, (width, height)" if "size" in in_order else ""
        raise SolariError(
            f"{owner}{method} takes ({', '.join(in_order)}) without names, not {len(values)} values"
            f"{named and f'; others have names: {named}'}{pair}"
        )


def warn_of_old_name(what: str, old: str, new: str) -> None:
    """Warn that `old` has another name now."""
    warn(f"{what}: {old} is called {new} now; the old name goes with version 0.4", FutureWarning)


def warn(text: str, kind: type[Warning] = UserWarning) -> None:
    """Warn, at the line outside of the package that led here."""
    level, frame, passed = 2, sys._getframe(1), {__package__, "functools", "contextlib", "dataclasses"}
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] in passed:
        level, frame = level + 1, frame.f_back
    warnings.warn(text, kind, stacklevel=level)
