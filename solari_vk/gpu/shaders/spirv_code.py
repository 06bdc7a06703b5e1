"""Decodes SPIR-V into instructions, and finds which bound resources each entry point reads and writes.

The analysis follows pointers from every access back to the variable, through access chains, copies, selections and
the parameters of called functions. It is static: accesses in branches that are never taken count.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from solari_vk.base.errors import SolariError

MAGIC = 0x07230203
STORAGE_UNIFORM_CONSTANT, STORAGE_UNIFORM, STORAGE_PUSH_CONSTANT, STORAGE_BUFFER = 0, 2, 9, 12
STORAGE_SHADER_RECORD, STORAGE_PHYSICAL = 5343, 5349
RESOURCE_STORAGE = (STORAGE_UNIFORM_CONSTANT, STORAGE_UNIFORM, STORAGE_BUFFER)

OP_NAME, OP_MEMBER_NAME, OP_EXT_INST, OP_ENTRY_POINT, OP_EXECUTION_MODE = 5, 6, 12, 15, 16
OP_EXECUTION_MODE_ID, OP_DECORATE, OP_MEMBER_DECORATE = 331, 71, 72
OP_TYPE_POINTER, OP_VARIABLE = 32, 59
OP_FUNCTION, _OP_PARAMETER, _OP_FUNCTION_END, _OP_CALL = 54, 55, 56, 57
_OP_TEXEL_POINTER, _OP_LOAD, _OP_STORE, _OP_COPY_MEMORY, _OP_COPY_SIZED = 60, 61, 62, 63, 64
_OP_SAMPLED_IMAGE, _OP_IMAGE, _OP_PHI, _OP_SELECT, _OP_COPY_OBJECT = 86, 100, 245, 169, 83
_ACCESS_CHAINS = (65, 66, 67, 70)
_OP_U_TO_POINTER, _OP_BITCAST = 117, 124
_MAKES_POINTERS = frozenset(
    (
        *_ACCESS_CHAINS,
        _OP_TEXEL_POINTER,
        _OP_LOAD,
        _OP_COPY_OBJECT,
        _OP_IMAGE,
        _OP_SAMPLED_IMAGE,
        _OP_SELECT,
        _OP_PHI,
        _OP_U_TO_POINTER,
        _OP_BITCAST,
    )
)
_OP_IMAGE_WRITE, _OP_ATOMIC_LOAD, _OP_ATOMIC_STORE, _OP_ATOMIC_FLAG_CLEAR = 99, 227, 228, 319
# sampling, fetching, gathering and reading; then the same of sparse images
_IMAGE_READS = frozenset((*range(87, 99), *range(305, 316), 320))
# exchange, compare-exchange, arithmetic, bitwise, flag test; float minimum, maximum and sum
_ATOMICS = frozenset((*range(229, 243), 318, 5614, 5615, 6035))
_OP_RAY_QUERY_INITIALIZE, _OP_TRACE_RAY = 4473, 4445
_USES = frozenset((_OP_LOAD, 68, *range(101, 108)))  # also the length of an array, properties of an image
_FOLLOWED = frozenset(
    (
        *_MAKES_POINTERS,
        *_IMAGE_READS,
        *_ATOMICS,
        *_USES,
        _OP_CALL,
        _OP_STORE,
        _OP_COPY_MEMORY,
        _OP_COPY_SIZED,
        _OP_IMAGE_WRITE,
        _OP_ATOMIC_LOAD,
        _OP_ATOMIC_STORE,
        _OP_ATOMIC_FLAG_CLEAR,
        _OP_RAY_QUERY_INITIALIZE,
        _OP_TRACE_RAY,
        OP_EXT_INST,
        OP_FUNCTION,
        _OP_PARAMETER,
        OP_VARIABLE,
        _OP_FUNCTION_END,
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
    if len(words) < 5 or words[0] != MAGIC:
        raise SolariError(f"{name}: this is not a SPIR-V module")
    decoded, position, in_functions = [], 5, False
    while position < len(words):
        op, count = words[position] & 0xFFFF, words[position] >> 16
        if count == 0 or position + count > len(words):
            raise SolariError(f"{name}: the SPIR-V module is cut off or damaged at word {position}")
        in_functions = in_functions or op == OP_FUNCTION
        if not in_functions or op in _FOLLOWED:
            decoded.append(Instruction(op, words[position + 1 : position + count]))
        position += count
    return decoded


def text(words: list[int]) -> str:
    """The string that starts at the first of these words."""
    return np.array(words, np.uint32).tobytes().split(b"\0", 1)[0].decode(errors="replace")


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
            op, words = item
            if op == OP_TYPE_POINTER and words[1] == STORAGE_PHYSICAL:
                self._physical_types.add(words[0])
            elif op == OP_FUNCTION:
                current = self._functions[words[1]] = Function()
            elif op == _OP_FUNCTION_END:
                current = None
            elif op == _OP_PARAMETER and current is not None:
                current.parameters.append(words[1])
                self._type_of[words[1]] = words[0]
            elif op == OP_VARIABLE:
                self._type_of[words[1]] = words[0]
                if words[2] in RESOURCE_STORAGE:
                    self._variables[words[1]] = words[2]
            elif current is not None:
                current.body.append(item)
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
        used, read, written = self._done[key] = (set[int](), set[int](), set[int]())
        body = self._functions[function]
        roots = _Roots(self._variables, self._made_by, dict(zip(body.parameters, arguments, strict=True)))
        for op, words in body.body:
            if op == _OP_CALL:
                inner = self.effects(words[2], tuple(roots.of(argument) for argument in words[3:]))
                for mine, theirs in zip((used, read, written), inner, strict=True):
                    mine |= theirs
                continue
            if op in _USES:
                used |= roots.of(words[2])
            for pointer in _reads(op, words):
                if not (op == _OP_LOAD and self._is_handle(pointer, roots)):
                    read |= roots.of(pointer)
            for pointer in _writes(op, words):
                if self._type_of.get(pointer) in self._physical_types:
                    if self._writes_by_address:
                        continue
                    raise SolariError(
                        f"{self._module}: writes through a buffer_reference, for which barriers can't be derived. "
                        "Write to a bound buffer instead, and declare the reference readonly"
                    )
                written |= roots.of(pointer)
        used |= read | written
        return used, read, written

    def _is_handle(self, pointer: int, roots: _Roots) -> bool:
        """Whether a pointer leads to an image, sampler or acceleration structure: loading one accesses no contents."""
        return any(self._variables[root] == STORAGE_UNIFORM_CONSTANT for root in roots.of(pointer))


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
        if made and made.op == _OP_LOAD:  # a value loaded from a buffer is not a pointer to it
            found = frozenset(root for root in found if self._variables[root] == STORAGE_UNIFORM_CONSTANT)
        self._known[value] = found
        return found


def _sources(item: Instruction) -> list[int]:
    op, words = item
    if op in _ACCESS_CHAINS or op in (_OP_TEXEL_POINTER, _OP_LOAD, _OP_COPY_OBJECT, _OP_IMAGE):
        return [words[2]]
    if op == _OP_SAMPLED_IMAGE:
        return words[2:4]
    if op == _OP_SELECT:
        return words[3:5]
    if op == _OP_PHI:
        return words[2::2]
    return []


def _reads(op: int, words: list[int]) -> list[int]:
    if op in (_OP_LOAD, _OP_ATOMIC_LOAD) or op in _IMAGE_READS or op in _ATOMICS:
        return [words[2]]
    if op in (_OP_COPY_MEMORY, _OP_COPY_SIZED, _OP_RAY_QUERY_INITIALIZE):
        return [words[1]]
    if op == _OP_TRACE_RAY:
        return [words[0]]
    return words[4:] if op == OP_EXT_INST else []


def _writes(op: int, words: list[int]) -> list[int]:
    if op in (_OP_STORE, _OP_COPY_MEMORY, _OP_COPY_SIZED, _OP_IMAGE_WRITE, _OP_ATOMIC_STORE, _OP_ATOMIC_FLAG_CLEAR):
        return [words[0]]
    if op in _ATOMICS:
        return [words[2]]
    # modf and frexp write through a pointer
    return words[4:] if op == OP_EXT_INST and words[3] in (35, 51) else []
