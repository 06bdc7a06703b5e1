"""The exceptions of the package. Every mistake of a user, a file or a driver becomes one of them."""

from __future__ import annotations

import difflib
import functools
import inspect
import re
import sys
import warnings
from abc import ABCMeta
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, ParamSpec, TypeVar

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")

MAX_NAMES = 16  # that a message lists; of more it lists the NEAREST to what was given
NEAREST = 5
MAX_VALUE = 80  # characters of a value that a message quotes
MAX_LINE = 2000
OTHER_WORDS = Path(__file__).with_name("other_words.toml")
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


def reworded(error: SolariError, text: str) -> SolariError:
    """An error of the same class with another text, and of a group with the same exceptions."""
    group = (error.exceptions,) if isinstance(error, ExceptionGroup) else ()
    return type(error)(text, *group)


@functools.cache
def other_words() -> dict[str, dict[str, str]]:
    """The advice in other_words.toml: by what is asked, such as "Material", and by word, in lower case, what to say."""
    import tomllib  # when the first error needs it: most programs never do

    advice: dict[str, dict[str, str]] = {}
    try:
        entries = tomllib.loads(OTHER_WORDS.read_text(encoding="utf-8"))["advice"]
    except OSError:  # programs that PyInstaller packs may lack the file, and an error must not need it
        return advice
    for entry in entries:
        answer = entry.pop("say")
        for asked, words in entry.items():
            advice.setdefault(asked, {}).update(dict.fromkeys(words, answer))
    return advice


def advice_for(what: str, name: str) -> str:
    """What a name of other programs is called here; "" if there is nothing to say.

    what: the start of a message, such as "Material has no field".
    """
    return other_words().get(what.partition(" ")[0].rstrip(":"), {}).get(name, "")


def is_name(value: object, known: Container[str]) -> bool:
    """Whether a value is one of the known names. Others than strings aren't, and may be such as can't be looked up."""
    return isinstance(value, str) and value in known


def unknown_name(what: str, name: object, known: Iterable[str]) -> SolariError:
    """The error for a name that isn't among the known ones: it says what another program's word is called here;
    otherwise it suggests the closest name, and lists a few names, or of many the nearest.

    what: the start of the message, such as "Material has no field".
    """
    if isinstance(name, str):
        advice = advice_for(what, name.lower())
        if advice:
            return SolariError(f"{what} {quoted(name)}: {advice}")
    names = list(dict.fromkeys(filter(None, known)))  # each once, in their order
    text = name if isinstance(name, str) else quoted(name)
    text = text[:MAX_VALUE].lower()  # comparing takes the square of the length
    closest = _closest_name(text, names)
    hint = f"did you mean '{closest}'? " if closest else ""
    return SolariError(f"{what} {quoted(name)}; {hint}{_list_of(names, text, closest)}")


def _closest_name(text: str, names: Sequence[str]) -> str:
    """The name that a text in lower case stands for most likely, "" if none is near."""
    # Of names that differ by case alone the first one is kept.
    by_lower = {name.lower(): name for name in reversed(names)}
    # From sure to unsure: a slip of the finger, a longer word such as add_light for add, a similar word, a part of one.
    candidates = (
        difflib.get_close_matches(text, by_lower, 1, 0.8)
        or [name for name in by_lower if text.startswith(f"{name}_")]
        or difflib.get_close_matches(text, by_lower, 1)
        or [name for name in by_lower if _is_part(text, name) or _is_part(name, text)]
    )
    return by_lower[candidates[0]] if candidates else ""


def _is_part(part: str, whole: str) -> bool:
    # One or two letters are a part of almost any word.
    return len(part) > 2 and part in whole


def _list_of(names: Sequence[str], text: str, closest: str) -> str:
    """All names if they are few, else those that are nearest to a text, the closest one first."""
    if not names:
        return "there are none"
    if len(names) <= MAX_NAMES:
        return f"there are {', '.join(names)}"
    by_lower = {name.lower(): name for name in reversed(names)}
    nearest = [by_lower[name] for name in difflib.get_close_matches(text, by_lower, NEAREST, 0.0)]
    listed = dict.fromkeys([closest, *nearest] if closest else nearest)
    return f"the nearest of {len(names)} are {', '.join(list(listed)[:NEAREST])}"


def unknown_attribute(what: str, name: str, known: Callable[[], Iterable[str]]) -> AttributeError:
    """As `unknown_name`, of the type that Python expects where attributes are looked up; private names get no hint."""
    text = f"{what} '{name}'"
    if not name.startswith("_"):
        text = str(unknown_name(what, name, (name for name in known() if not name.startswith("_"))))
    # With name=None Python adds no suggestion of its own, which may be private.
    return AttributeError(text, name=None)


class _Hinting(ABCMeta):  # of ABCs, so that classes with abstract methods can have hints too
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
        signature = _Signature(method, hint, who)

        @functools.wraps(method)
        def checked(*values: Parameters.args, **options: Parameters.kwargs) -> Result:
            signature.check(values, options)
            return method(*values, **options)

        return checked

    return decorate


def checked_constructor(kind: type[Result]) -> type[Result]:
    """A decorator of classes, outside of `dataclass`: their constructors raise the errors of `checked_keywords`."""
    setattr(kind, "__init__", checked_keywords()(kind.__init__))  # noqa: B010
    return kind


class _Signature:
    """The parameters of a method, or of a function of the module `who`, and the errors for calls that don't fit."""

    def __init__(self, method: Callable[..., Any], hint: str, who: str) -> None:
        parameters = list(inspect.signature(method).parameters.values())
        if not who:
            del parameters[0]  # self
        self._hint = hint
        self._who = who
        self._suffix = "" if method.__name__ == "__init__" else f".{method.__name__}"
        self._names = [p.name for p in parameters if p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)]
        self._in_order = [p.name for p in parameters if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)]
        self._takes_any_count = any(p.kind == p.VAR_POSITIONAL for p in parameters)
        self._takes_any_name = any(p.kind == p.VAR_KEYWORD for p in parameters)
        self._needed = [p.name for p in parameters if p.default is p.empty and p.name in self._names]

    def check(self, values: Sequence[Any], options: Mapping[str, object]) -> None:
        """Raise SolariError if a call with these values, `self` among them, and options doesn't fit."""
        owner = self._who or type(values[0]).__name__
        positional = values if self._who else values[1:]
        for name in options:
            if name not in self._names and not self._takes_any_name:
                error = unknown_name(f"{owner}{self._suffix} has no option", name, self._names)
                advised = advice_for(f"{owner}{self._suffix}", name.lower())
                raise SolariError(f"{error}; {self._hint}" if self._hint and not advised else str(error))
        if not self._takes_any_count:
            check_count(owner, self._suffix, positional, self._in_order, self._names)
        # Python's own TypeError for them wouldn't say what else the function takes.
        given = {*self._in_order[: len(positional)], *options}
        missing = [name for name in self._needed if name not in given]
        if missing:
            takes = ", ".join(self._names)
            example = advice_for(f"{owner}{self._suffix}", "()")
            raise SolariError(
                f"{owner}{self._suffix} needs {', '.join(missing)}: it takes ({takes})" + (example and f"; {example}")
            )


def check_count(
    owner: str, method: str, values: Sequence[object], in_order: Sequence[str], known: Iterable[str]
) -> None:
    """Raise SolariError for more values than the parameters `in_order`, the only ones that are given without names."""
    if len(values) <= len(in_order):
        return
    message = f"{owner}{method} takes ({', '.join(in_order)}) without names, not {len(values)} values"
    named = shortened(", ".join(f"{name}=" for name in known if name not in in_order))
    if named:
        message += f"; others have names: {named}"
    if "size" in in_order:
        message += "; the size is one pair, (width, height)"
    raise SolariError(message)


def warn(text: str) -> None:
    """Warn, at the line outside of the package that led here."""
    # A frame of the standard library is passed too where it runs code of ours: a decorator, a context, a constructor.
    passed = {"solari_vk", "functools", "contextlib", "dataclasses"}
    level = 2
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] in passed:
        level += 1
        frame = frame.f_back
    warnings.warn(text, stacklevel=level)
