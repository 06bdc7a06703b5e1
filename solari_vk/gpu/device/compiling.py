"""Tells the user of a device what is being compiled."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar

T = TypeVar("T")


@dataclass(frozen=True)
class Compiling:
    """The state of a list of things that are being compiled; `str` is words such as "compiling pipelines 7 of 19".

    what: "shaders", from GLSL to SPIR-V; "pipelines"; or "machine code", which software drivers make of a pipeline when
    it first runs. done: how many of `total` are finished, in their order. name: the first one that isn't finished, ""
    at the end of the list. Threads may already work at later ones.
    """

    what: str
    done: int
    total: int
    name: str

    def __str__(self) -> str:
        if self.done == self.total:
            return f"compiled {self.what}: {self.total}"
        return f"compiling {self.what} {self.done + 1} of {self.total}: {self.name}"


OnCompile = Callable[[Compiling], object]


@contextmanager
def announced(
    on_compile: OnCompile | None, what: str, names: Sequence[str], items: Sequence[T]
) -> Iterator[Iterator[T]]:
    """A context with the items, each after its name was announced; at its end, also by an error, that all are done."""

    def each() -> Iterator[T]:
        for done, (name, item) in enumerate(zip(names, items, strict=True)):
            if on_compile is not None:
                on_compile(Compiling(what, done, len(items), name))
            yield item

    try:
        yield each()
    finally:
        if on_compile is not None and items:
            on_compile(Compiling(what, len(items), len(items), ""))
