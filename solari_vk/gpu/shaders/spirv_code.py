"""Decodes SPIR-V into instructions, and finds which bound resources each entry point reads and writes.

The analysis follows pointers from every access back to the variable, through access chains, copies, selections and
the parameters of called functions. It is static: accesses in branches that are never taken count.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from solari_vk.base.errors import SolariError
from solari_vk.gpu.shaders import spv

_MAKES_POINTERS = frozenset(
    (
        *spv.ACCESS_CHAINS,
        spv.OP_IMAGE_TEXEL_POINTER,
        spv.OP_LOAD,
        spv.OP_COPY_OBJECT,
        spv.OP_IMAGE,
        spv.OP_SAMPLED_IMAGE,
        spv.OP_SELECT,
        spv.OP_PHI,
        spv.OP_CONVERT_U_TO_PTR,
        spv.OP_BITCAST,
    )
)
# Sampling, fetching, gathering and reading; then the same of sparse images.
_IMAGE_READS = frozenset((*range(87, 99), *range(305, 316), 320))
# Exchange, compare-exchange, arithmetic, bitwise, flag test; minimum, maximum and sum of floats.
_ATOMICS = frozenset((*range(229, 243), 318, 5614, 5615, 6035))
_USES = frozenset((spv.OP_LOAD, spv.OP_ARRAY_LENGTH, *range(101, 108)))  # also properties of an image
_STORES = frozenset(
    (
        spv.OP_STORE,
        spv.OP_COPY_MEMORY,
        spv.OP_COPY_MEMORY_SIZED,
        spv.OP_IMAGE_WRITE,
        spv.OP_ATOMIC_STORE,
        spv.OP_ATOMIC_FLAG_CLEAR,
    )
)
_EXT_INST_WRITES = (35, 51)  # modf and frexp of GLSL.std.450, which write through a pointer
# What the analysis needs of functions; arithmetic, the most of the code, is skipped when a module is decoded.
_FOLLOWED = frozenset(
    (
        *_MAKES_POINTERS,
        *_IMAGE_READS,
        *_ATOMICS,
        *_USES,
        *_STORES,
        spv.OP_FUNCTION_CALL,
        spv.OP_ATOMIC_LOAD,
        spv.OP_RAY_QUERY_INITIALIZE,
        spv.OP_TRACE_RAY,
        spv.OP_EXT_INST,
        spv.OP_FUNCTION,
        spv.OP_FUNCTION_PARAMETER,
        spv.OP_VARIABLE,
        spv.OP_FUNCTION_END,
    )
)


class Instruction(NamedTuple):
    """An instruction: its opcode and operand words."""

    op: int
    words: list[int]


@dataclass
class Function:
    """A function: the ids of its parameters, and its instructions."""

    parameters: list[int] = field(default_factory=list)
    body: list[Instruction] = field(default_factory=list)


def instructions(spirv: bytes, name: str) -> list[Instruction]:
    """The declarations of a module, then of its functions what AccessAnalysis follows, a fifth of the instructions.

    Raises SolariError if the bytes aren't a SPIR-V module.
    """
    words = np.frombuffer(spirv[: len(spirv) & ~3], np.uint32).tolist()
    if len(words) < 5 or words[0] != spv.MAGIC:
        raise SolariError(f"{name}: this is not a SPIR-V module")
    decoded = []
    position = spv.HEADER_WORDS
    in_functions = False
    while position < len(words):
        op, count = words[position] & 0xFFFF, words[position] >> 16
        if count == 0 or position + count > len(words):
            raise SolariError(f"{name}: the SPIR-V module is cut off or damaged at word {position}")
        in_functions = in_functions or op == spv.OP_FUNCTION
        # Declarations are all kept: reflection needs them.
        if not in_functions or op in _FOLLOWED:
            decoded.append(Instruction(op, words[position + 1 : position + count]))
        position += count
    return decoded


class AccessAnalysis:
    """Finds which variables in resource storage classes each function reads and writes.

    writes_by_address: writes through buffer references are of no variable; otherwise they are refused.
    """

    def __init__(self, code: list[Instruction], module: str, writes_by_address: bool = False) -> None:
        self._module = module
        self._writes_by_address = writes_by_address
        self._functions: dict[int, Function] = {}
        self._variables: dict[int, int] = {}
        self._physical_types: set[int] = set()
        self._made_by: dict[int, Instruction] = {}
        self._type_of: dict[int, int] = {}
        self._done: dict[tuple[int, tuple[frozenset[int], ...]], tuple[set[int], set[int], set[int]]] = {}
        current: Function | None = None
        for item in code:
            match item.op:
                case spv.OP_FUNCTION:
                    current = self._functions[item.words[1]] = Function()
                case spv.OP_FUNCTION_END:
                    current = None
                case _ if current is not None:
                    self._add(item, current)
                case spv.OP_TYPE_POINTER if item.words[1] == spv.STORAGE_PHYSICAL:
                    self._physical_types.add(item.words[0])
                case spv.OP_VARIABLE:
                    self._declare(item.words)

    def _declare(self, words: list[int]) -> None:
        """Remember a variable, of the module or of a function."""
        self._type_of[words[1]] = words[0]
        if words[2] in spv.RESOURCE_STORAGE:
            self._variables[words[1]] = words[2]

    def _add(self, item: Instruction, function: Function) -> None:
        """Remember an instruction of a function."""
        op, words = item
        if op == spv.OP_FUNCTION_PARAMETER:
            function.parameters.append(words[1])
            self._type_of[words[1]] = words[0]
        elif op == spv.OP_VARIABLE:
            self._declare(words)
        else:
            function.body.append(item)
            if op in _MAKES_POINTERS:
                self._made_by[words[1]] = item
                self._type_of[words[1]] = words[0]

    def effects(self, function: int, arguments: tuple[frozenset[int], ...] = ()) -> tuple[set[int], set[int], set[int]]:
        """The ids of the variables that a function and those it calls use, read and write.

        arguments: the variables that its parameters may point to. Asking for a length or a size is a use only.
        """
        key = (function, arguments)
        if key in self._done:
            return self._done[key]
        used = set[int]()
        read = set[int]()
        written = set[int]()
        self._done[key] = used, read, written
        body = self._functions[function]
        roots = _Roots(self._variables, self._made_by, dict(zip(body.parameters, arguments, strict=True)))
        for op, words in body.body:
            # What a called function does depends on what its pointer parameters point to here.
            if op == spv.OP_FUNCTION_CALL:
                inner = self.effects(words[2], tuple(roots.of(argument) for argument in words[3:]))
                for mine, theirs in zip((used, read, written), inner, strict=True):
                    mine |= theirs
                continue
            if op in _USES:
                used |= roots.of(words[2])
            for pointer in _reads(op, words):
                # Loading an image or a structure from its variable reads a handle, not the contents.
                if not (op == spv.OP_LOAD and self._is_handle(pointer, roots)):
                    read |= roots.of(pointer)
            for pointer in _writes(op, words):
                if self._type_of.get(pointer) in self._physical_types:
                    self._check_write_by_address()
                else:
                    written |= roots.of(pointer)
        # Whatever is read or written is used; lengths and sizes are uses alone.
        used |= read | written
        return used, read, written

    def _check_write_by_address(self) -> None:
        if not self._writes_by_address:
            raise SolariError(
                f"{self._module}: writes through a buffer_reference, for which barriers can't be derived. "
                "Write to a bound buffer instead, and declare the reference readonly"
            )

    def _is_handle(self, pointer: int, roots: _Roots) -> bool:
        """Whether a pointer leads to an image, sampler or acceleration structure: loading one accesses no contents."""
        return any(self._variables[root] == spv.STORAGE_UNIFORM_CONSTANT for root in roots.of(pointer))


class _Roots:
    """Finds the variables that a pointer, or an image or acceleration structure loaded from one, may come from."""

    def __init__(
        self, variables: dict[int, int], made_by: dict[int, Instruction], parameters: dict[int, frozenset[int]]
    ) -> None:
        self._variables = variables
        self._made_by = made_by
        self._known = dict(parameters)

    def of(self, value: int) -> frozenset[int]:
        """The ids of the variables; empty for a value that is local to the invocation."""
        known = self._known.get(value)
        if known is not None:
            return known
        if value in self._variables:
            return frozenset((value,))
        self._known[value] = frozenset()  # ends the recursion at the phi of a loop
        made = self._made_by.get(value)
        found = frozenset(root for source in _sources(made) for root in self.of(source)) if made else frozenset()
        if made and made.op == spv.OP_LOAD:  # a value loaded from a buffer is not a pointer to it
            found = frozenset(root for root in found if self._variables[root] == spv.STORAGE_UNIFORM_CONSTANT)
        self._known[value] = found
        return found


def _sources(item: Instruction) -> list[int]:
    op, words = item
    if op in spv.ACCESS_CHAINS or op in (spv.OP_IMAGE_TEXEL_POINTER, spv.OP_LOAD, spv.OP_COPY_OBJECT, spv.OP_IMAGE):
        return [words[2]]
    if op == spv.OP_SAMPLED_IMAGE:
        return words[2:4]
    if op == spv.OP_SELECT:
        return words[3:5]
    if op == spv.OP_PHI:
        return words[2::2]
    return []


def _reads(op: int, words: list[int]) -> list[int]:
    if op in (spv.OP_LOAD, spv.OP_ATOMIC_LOAD) or op in _IMAGE_READS or op in _ATOMICS:
        return [words[2]]
    if op in (spv.OP_COPY_MEMORY, spv.OP_COPY_MEMORY_SIZED, spv.OP_RAY_QUERY_INITIALIZE):
        return [words[1]]
    if op == spv.OP_TRACE_RAY:
        return [words[0]]
    return words[4:] if op == spv.OP_EXT_INST else []


def _writes(op: int, words: list[int]) -> list[int]:
    if op in (
        spv.OP_STORE,
        spv.OP_COPY_MEMORY,
        spv.OP_COPY_MEMORY_SIZED,
        spv.OP_IMAGE_WRITE,
        spv.OP_ATOMIC_STORE,
        spv.OP_ATOMIC_FLAG_CLEAR,
    ):
        return [words[0]]
    if op in _ATOMICS:
        return [words[2]]
    return words[4:] if op == spv.OP_EXT_INST and words[3] in _EXT_INST_WRITES else []
