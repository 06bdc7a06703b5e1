"""Storage buffers that a compute shader accesses by their addresses in place of descriptors, for software devices.

Lavapipe makes a loop over eight invocations of every load from a bound storage buffer, and compares each offset with
the buffer's size; a load from an address is one instruction. Its compiler's time grows with the square of the number of
blocks, and so realtime frames are compiled in a sixth of the time, and run faster too. The addresses are push
constants. No access is compared with a size any more, as on graphics cards, and synchronization validation doesn't see
it.

Accesses are followed from access chains, which glslang makes for each; a buffer whose pointers go elsewhere, to a
function or an atomic operation, stays as it is.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from solari_vk.gpu.shaders.ray_generation import instructions
from solari_vk.gpu.shaders.spirv_code import (
    OP_ENTRY_POINT,
    OP_FUNCTION,
    OP_TYPE_POINTER,
    OP_VARIABLE,
    STORAGE_PHYSICAL,
    STORAGE_PUSH_CONSTANT,
)

Words = list[int]

ADDRESS_BYTES = 8
_MEMORY_MODEL, _CAPABILITY, _DECORATE, _MEMBER_DECORATE = 14, 17, 71, 72
_TYPE_INT, _TYPE_FLOAT, _TYPE_ARRAYS, _TYPE_STRUCT, _CONSTANT = 21, 22, (23, 24, 28, 29), 30, 43
_LOAD, _STORE, _CHAINS, _ARRAY_LENGTH = 61, 62, (65, 66), 68
_PHYSICAL_ADDRESSES, _PHYSICAL_64, _BLOCK, _OFFSET, _ALIGNED = 5347, 5348, 2, 35, 2


@lru_cache(maxsize=128)
def access_by_address(spirv: bytes, buffers: tuple[tuple[int, str], ...], most: int) -> tuple[bytes, tuple[str, ...]]:
    """The module that accesses up to `most` buffers by address, and their names in the order of their addresses in the
    push constants.

    spirv: a module of SPIR-V 1.6 without push constants. buffers: the ids of storage buffers' variables, and their
    names.
    """
    names = dict(buffers)
    listed = list(instructions(spirv))
    first = next(i for i, words in enumerate(listed) if words[0] & 0xFFFF == OP_FUNCTION)
    declarations, code = listed[:first], listed[first:]
    chains = _chains(code, set(names))
    elsewhere = set[int]()
    for words in code:
        op = words[0] & 0xFFFF
        if op not in (*_CHAINS, _LOAD, _ARRAY_LENGTH):
            elsewhere |= {chains[word] for word in words[2 if op == _STORE else 1 :] if word in chains}
    roots = sorted({*chains.values()} - elsewhere, key=names.__getitem__)[:most]
    places = {variable: at for at, variable in enumerate(roots)}
    chains = {chain: root for chain, root in chains.items() if root in places}
    if not places:
        return spirv, ()
    module = _Module(declarations, int(np.frombuffer(spirv[12:16], np.uint32)[0]))
    pushed, pointers = module.push(list(places))
    made: list[Words] = []
    stored: dict[int, int] = {}  # type of what each chain points to
    for words in code:
        op = words[0] & 0xFFFF
        if op in _CHAINS and words[2] in chains:
            stored[words[2]] = module.pointees[words[1]]
            words = [words[0], module.physical(module.pointees[words[1]]), *words[2:]]
            if (variable := words[3]) in places:
                at = places[variable]
                to_address, address = module.new_id(), module.new_id()
                made.append(_words(65, pointers[at][0], to_address, pushed, module.index(at)))
                made.append(_words(_LOAD, pointers[at][1], address, to_address))
                words[3] = address
        elif op == _LOAD and words[3] in chains:
            words = _aligned(words, 4, module.scalar_size(words[1]))
        elif op == _STORE and words[1] in chains:
            words = _aligned(words, 3, module.scalar_size(stored[words[1]]))
        made.append(words)
    header = np.frombuffer(spirv[:20], np.uint32).copy()
    joined = [word for words in (*module.finished(), *made) for word in words]
    header[3] = module.bound
    return header.tobytes() + np.array(joined, np.uint32).tobytes(), tuple(names[variable] for variable in places)


def _words(op: int, *operands: int) -> Words:
    return [(len(operands) + 1) << 16 | op, *operands]


def _aligned(words: Words, at: int, size: int) -> Words:
    """A load or store, whose memory operands are words from `at` on, with the alignment that addresses need."""
    mask = words[at] if len(words) > at else 0
    if mask & _ALIGNED:
        return words
    return _words(words[0] & 0xFFFF, *words[1:at], mask | _ALIGNED, size, *words[at + 1 :])


def _chains(code: list[Words], variables: set[int]) -> dict[int, int]:
    """The variable of each access chain that starts at one of these or at a chain from one; and of itself."""
    found = {variable: variable for variable in variables}
    for words in code:
        if words[0] & 0xFFFF in _CHAINS and words[3] in found:
            found[words[2]] = found[words[3]]
    roots = {root for chain, root in found.items() if chain not in variables}
    return {chain: root for chain, root in found.items() if root in roots}


class _Module:
    """The declarations of a module, to which more are added. `pointees`: what each pointer type points to."""

    def __init__(self, declarations: list[Words], bound: int) -> None:
        self._declarations = declarations
        self._added: list[Words] = []
        self._decorations: list[Words] = []
        self.bound = bound
        self._types = {words[1]: words for words in declarations if words[0] & 0xFFFF in range(19, 40)}
        self.pointees = {i: words[3] for i, words in self._types.items() if words[0] & 0xFFFF == OP_TYPE_POINTER}
        self._variables = {words[2]: words[1] for words in declarations if words[0] & 0xFFFF == OP_VARIABLE}
        self._physical = {
            words[3]: i
            for i, words in self._types.items()
            if words[0] & 0xFFFF == OP_TYPE_POINTER and words[2] == STORAGE_PHYSICAL
        }
        self._pushed = 0

    def new_id(self) -> int:
        self.bound += 1
        return self.bound - 1

    def _add(self, op: int, *operands: int) -> int:
        """Add the declaration of a type; returns its id."""
        made = self.new_id()
        self._added.append(_words(op, made, *operands))
        return made

    def physical(self, pointee: int) -> int:
        """The type of addresses of a type."""
        if pointee not in self._physical:
            self._physical[pointee] = self._add(OP_TYPE_POINTER, STORAGE_PHYSICAL, pointee)
        return self._physical[pointee]

    def index(self, value: int) -> int:
        """A constant integer."""
        if value not in self._indices:
            made = self._indices[value] = self.new_id()
            self._added.append(_words(_CONSTANT, self._integer, made, value))
        return self._indices[value]

    def push(self, variables: list[int]) -> tuple[int, list[tuple[int, int]]]:
        """Declare push constants with the addresses of the buffers of these variables. Returns their variable, and for
        each the types of a pointer to the address and of the address."""
        integers = [i for i, words in self._types.items() if words[0] & 0xFFFF == _TYPE_INT and words[2:] == [32, 0]]
        self._integer = integers[0] if integers else self._add(_TYPE_INT, 32, 0)
        self._indices = {
            words[3]: words[2]
            for words in self._declarations
            if words[0] & 0xFFFF == _CONSTANT and words[1] == self._integer
        }
        members = [self.physical(self.pointees[self._variables[variable]]) for variable in variables]
        block = self._add(_TYPE_STRUCT, *members)
        self._decorations.append(_words(_DECORATE, block, _BLOCK))
        for at in range(len(members)):
            self._decorations.append(_words(_MEMBER_DECORATE, block, at, _OFFSET, ADDRESS_BYTES * at))
        pointer = self._add(OP_TYPE_POINTER, STORAGE_PUSH_CONSTANT, block)
        to_members = {member: self._add(OP_TYPE_POINTER, STORAGE_PUSH_CONSTANT, member) for member in set(members)}
        self._pushed = self.new_id()
        self._added.append(_words(OP_VARIABLE, pointer, self._pushed, STORAGE_PUSH_CONSTANT))
        for at in range(len(members)):
            self.index(at)
        return self._pushed, [(to_members[member], member) for member in members]

    def scalar_size(self, kind: int) -> int:
        """The bytes of the largest scalar in a type, to which its values in buffers are aligned."""
        op, operands = self._types[kind][0] & 0xFFFF, self._types[kind][2:]
        if op in (_TYPE_INT, _TYPE_FLOAT):
            return operands[0] // 8
        if op == OP_TYPE_POINTER:
            return ADDRESS_BYTES
        return max(self.scalar_size(part) for part in (operands[:1] if op in _TYPE_ARRAYS else operands))

    def finished(self) -> list[Words]:
        """The declarations, with those that were added where SPIR-V wants them."""
        capability = _words(_CAPABILITY, _PHYSICAL_ADDRESSES)
        made = [] if capability in self._declarations else [capability]
        first = next(at for at, words in enumerate(self._declarations) if words[0] & 0xFFFF in range(19, 60))
        for words in self._declarations[:first]:
            if words[0] & 0xFFFF == _MEMORY_MODEL:
                words = [words[0], _PHYSICAL_64, words[2]]
            elif words[0] & 0xFFFF == OP_ENTRY_POINT:
                words = [words[0] + (1 << 16), *words[1:], self._pushed]
            made.append(words)
        return [*made, *self._decorations, *self._declarations[first:], *self._added]
