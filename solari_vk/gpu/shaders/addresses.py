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

from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np

from solari_vk.gpu.shaders import spv
from solari_vk.gpu.shaders.spv import Words

ADDRESS_BYTES = 8
_CHAINS = (spv.OP_ACCESS_CHAIN, spv.OP_IN_BOUNDS_ACCESS_CHAIN)
_DECLARED_TYPES = range(spv.OP_TYPE_VOID, spv.OP_TYPE_FORWARD_POINTER + 1)
_DECLARED = range(spv.OP_TYPE_VOID, spv.OP_VARIABLE + 1)  # types, constants and variables
_TYPE_ARRAYS = (spv.OP_TYPE_VECTOR, spv.OP_TYPE_MATRIX, spv.OP_TYPE_ARRAY, spv.OP_TYPE_RUNTIME_ARRAY)


@lru_cache(maxsize=128)
def access_by_address(
    spirv: bytes, buffers: tuple[tuple[int, str], ...], most: int, table: tuple[int, tuple[str, ...]] | None = None
) -> tuple[bytes, tuple[str, ...]]:
    """The module that accesses up to `most` buffers by address, and their names in the order of their addresses in the
    push constants.

    spirv: a module of SPIR-V 1.6 without push constants. buffers: the ids of buffers' variables, and their names.
    table: in place of push constants, the binding in set 0 of a uniform block, and the names of all addresses in it.
    """
    names = dict(buffers)
    declarations, code = _split(spirv)
    chains = _chains(code, set(names))
    roots = sorted({*chains.values()} - _used_elsewhere(code, chains), key=names.__getitem__)[:most]
    if not roots:
        return spirv, ()
    module = _Module(declarations, int(np.frombuffer(spirv[:20], np.uint32)[spv.ID_BOUND]))
    chains = {chain: root for chain, root in chains.items() if root in roots}
    places = range(len(roots)) if table is None else [table[1].index(names[root]) for root in roots]
    pushed, pointers = module.push(roots, places, None if table is None else table[0])
    made = _by_address(code, chains, roots, module, pushed, pointers)
    header = np.frombuffer(spirv[:20], np.uint32).copy()
    joined = [word for words in (*module.finished(), *made) for word in words]
    header[spv.ID_BOUND] = module.bound
    return header.tobytes() + np.array(joined, np.uint32).tobytes(), tuple(names[variable] for variable in roots)


def addressable(spirv: bytes, variables: tuple[tuple[int, str], ...]) -> set[str]:
    """The names of those variables that a module accesses, and could access by address alone."""
    _, code = _split(spirv)
    chains = _chains(code, {variable for variable, _ in variables})
    elsewhere = _used_elsewhere(code, chains)
    # Only a descriptor knows the length of an array.
    elsewhere |= {words[3] for words in code if spv.opcode(words) == spv.OP_ARRAY_LENGTH}
    return {name for variable, name in variables if variable in {*chains.values()} - elsewhere}


def _split(spirv: bytes) -> tuple[list[Words], list[Words]]:
    """The declarations of a module, and its functions."""
    listed = list(spv.instructions(spirv))
    first = next(i for i, words in enumerate(listed) if spv.opcode(words) == spv.OP_FUNCTION)
    return listed[:first], listed[first:]


def _used_elsewhere(code: list[Words], chains: Mapping[int, int]) -> set[int]:
    """The variables whose pointers are used by more than access chains, loads, stores and lengths."""
    found = set[int]()
    for words in code:
        op = spv.opcode(words)
        if op in (*_CHAINS, spv.OP_LOAD, spv.OP_ARRAY_LENGTH):
            continue
        # A store's first operand is where it stores to; a pointer that is stored itself goes elsewhere.
        operands = words[2:] if op == spv.OP_STORE else words[1:]
        found |= {chains[word] for word in operands if word in chains}
    return found


def _by_address(
    code: list[Words],
    chains: Mapping[int, int],
    roots: list[int],
    module: _Module,
    pushed: int,
    pointers: list[tuple[int, int]],
) -> list[Words]:
    """The code with chains that begin at addresses. roots: the variables of the buffers, in the order of addresses.
    pushed, pointers: as from `push`."""
    places = {variable: at for at, variable in enumerate(roots)}
    pointee_of: dict[int, int] = {}  # the type of what each chain leads to
    made: list[Words] = []
    for words in code:
        op = spv.opcode(words)
        if op in _CHAINS and words[2] in chains:
            pointee = module.pointees[words[1]]
            pointee_of[words[2]] = pointee
            pointer = module.physical(pointee)
            base = words[3]
            if base in places:
                # The chain begins at the buffer itself: its address is loaded from the push constants.
                at = places[base]
                to_address, address = module.new_id(), module.new_id()
                made.append(spv.encoded(spv.OP_ACCESS_CHAIN, pointers[at][0], to_address, pushed, module.index(at)))
                made.append(spv.encoded(spv.OP_LOAD, pointers[at][1], address, to_address))
                base = address
            words = [words[0], pointer, words[2], base, *words[4:]]
        elif op == spv.OP_LOAD and words[3] in chains:
            words = _aligned(words, 4, module.scalar_size(words[1]))
        elif op == spv.OP_STORE and words[1] in chains:
            words = _aligned(words, 3, module.scalar_size(pointee_of[words[1]]))
        made.append(words)
    return made


def _aligned(words: Words, at: int, size: int) -> Words:
    """A load or store, whose memory operands are words from `at` on, with the alignment that addresses need."""
    mask = words[at] if len(words) > at else 0
    if mask & spv.MEMORY_ALIGNED:
        return words
    return spv.encoded(spv.opcode(words), *words[1:at], mask | spv.MEMORY_ALIGNED, size, *words[at + 1 :])


def _chains(code: list[Words], variables: set[int]) -> dict[int, int]:
    """The variable of each access chain that starts at one of these or at a chain from one; and of itself."""
    found = {variable: variable for variable in variables}
    for words in code:
        if spv.opcode(words) in _CHAINS and words[3] in found:
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
        self._types = {words[1]: words for words in declarations if spv.opcode(words) in _DECLARED_TYPES}
        self.pointees = {i: words[3] for i, words in self._types.items() if spv.opcode(words) == spv.OP_TYPE_POINTER}
        self._variables = {words[2]: words[1] for words in declarations if spv.opcode(words) == spv.OP_VARIABLE}
        self._physical = {
            words[3]: i
            for i, words in self._types.items()
            if spv.opcode(words) == spv.OP_TYPE_POINTER and words[2] == spv.STORAGE_PHYSICAL
        }
        self._pushed = 0

    def new_id(self) -> int:
        self.bound += 1
        return self.bound - 1

    def _add(self, op: int, *operands: int) -> int:
        """Add the declaration of a type; returns its id."""
        made = self.new_id()
        self._added.append(spv.encoded(op, made, *operands))
        return made

    def physical(self, pointee: int) -> int:
        """The type of addresses of a type."""
        if pointee not in self._physical:
            self._physical[pointee] = self._add(spv.OP_TYPE_POINTER, spv.STORAGE_PHYSICAL, pointee)
        return self._physical[pointee]

    def index(self, value: int) -> int:
        """A constant integer."""
        if value not in self._indices:
            made = self._indices[value] = self.new_id()
            self._added.append(spv.encoded(spv.OP_CONSTANT, self._integer, made, value))
        return self._indices[value]

    def push(
        self, variables: list[int], places: Sequence[int], binding: int | None
    ) -> tuple[int, list[tuple[int, int]]]:
        """Declare push constants, or a uniform block, with the addresses of the buffers of these variables at places.
        Returns their variable, and for each the types of a pointer to the address and of the address."""
        storage = spv.STORAGE_PUSH_CONSTANT if binding is None else spv.STORAGE_UNIFORM
        # SPIR-V allows a type to be declared once: an existing type of unsigned 32-bit integers must be used.
        by_operands = {(spv.opcode(words), *words[2:]): number for number, words in self._types.items()}
        unsigned = by_operands.get((spv.OP_TYPE_INT, 32, 0))
        self._integer = self._add(spv.OP_TYPE_INT, 32, 0) if unsigned is None else unsigned
        self._indices = {
            words[3]: words[2]
            for words in self._declarations
            if spv.opcode(words) == spv.OP_CONSTANT and words[1] == self._integer
        }
        members = [self.physical(self.pointees[self._variables[variable]]) for variable in variables]
        block = self._add(spv.OP_TYPE_STRUCT, *members)
        self._decorations.append(spv.encoded(spv.OP_DECORATE, block, spv.DECORATION_BLOCK))
        for at, place in enumerate(places):
            self._decorations.append(
                spv.encoded(spv.OP_MEMBER_DECORATE, block, at, spv.DECORATION_OFFSET, ADDRESS_BYTES * place)
            )
        pointer = self._add(spv.OP_TYPE_POINTER, storage, block)
        to_members = {member: self._add(spv.OP_TYPE_POINTER, storage, member) for member in set(members)}
        self._pushed = self.new_id()
        self._added.append(spv.encoded(spv.OP_VARIABLE, pointer, self._pushed, storage))
        if binding is not None:
            self._decorations.append(spv.encoded(spv.OP_DECORATE, self._pushed, spv.DECORATION_SET, 0))
            self._decorations.append(spv.encoded(spv.OP_DECORATE, self._pushed, spv.DECORATION_BINDING, binding))
        # Constants must be declared before the functions: those of all indices are made now.
        for at in range(len(members)):
            self.index(at)
        return self._pushed, [(to_members[member], member) for member in members]

    def scalar_size(self, kind: int) -> int:
        """The bytes of the largest scalar in a type, to which its values in buffers are aligned."""
        words = self._types[kind]
        op = spv.opcode(words)
        operands = words[2:]
        if op in (spv.OP_TYPE_INT, spv.OP_TYPE_FLOAT):
            return operands[0] // 8
        if op == spv.OP_TYPE_POINTER:
            return ADDRESS_BYTES
        parts = operands[:1] if op in _TYPE_ARRAYS else operands  # of a struct all members
        return max(self.scalar_size(part) for part in parts)

    def finished(self) -> list[Words]:
        """The declarations, with those that were added where SPIR-V wants them."""
        capability = spv.encoded(spv.OP_CAPABILITY, spv.CAPABILITY_PHYSICAL_ADDRESSES)
        # Capabilities come first, decorations before types, and types before what uses them.
        made = [] if capability in self._declarations else [capability]
        first = next(at for at, words in enumerate(self._declarations) if spv.opcode(words) in _DECLARED)
        for words in self._declarations[:first]:
            if spv.opcode(words) == spv.OP_MEMORY_MODEL:
                words = [words[0], spv.ADDRESSING_PHYSICAL_64, words[2]]
            elif spv.opcode(words) == spv.OP_ENTRY_POINT:
                # Since SPIR-V 1.4 an entry point names all variables of module scope that it uses.
                words = spv.encoded(spv.OP_ENTRY_POINT, *words[1:], self._pushed)
            made.append(words)
        return [*made, *self._decorations, *self._declarations[first:], *self._added]
