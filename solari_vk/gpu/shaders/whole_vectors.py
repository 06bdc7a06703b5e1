"""Loads of vectors in place of their components. Mesa 22.3 sometimes takes x for what is loaded as y or z alone from a
buffer whose whole vector is loaded elsewhere: docs/driver_faults.md."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from solari_vk.gpu.shaders import spv
from solari_vk.gpu.shaders.spv import Words

_CHAINS = (spv.OP_ACCESS_CHAIN, spv.OP_IN_BOUNDS_ACCESS_CHAIN)
_BUFFERS = (spv.STORAGE_BUFFER, spv.STORAGE_PHYSICAL)


@lru_cache(maxsize=128)
def with_whole_vectors(spirv: bytes) -> bytes:
    """A module that loads no component of a vector in a buffer alone."""
    listed = list(spv.instructions(spirv))
    first = next(at for at, words in enumerate(listed) if spv.opcode(words) == spv.OP_FUNCTION)
    header = np.frombuffer(spirv[: 4 * spv.HEADER_WORDS], np.uint32).copy()
    module = _Module(listed[:first], int(header[spv.ID_BOUND]))
    code = [made for words in listed[first:] for made in module.rewritten(words)]
    header[spv.ID_BOUND] = module.bound
    joined = [word for words in (*listed[:first], *module.added, *code) for word in words]
    return header.tobytes() + np.array(joined, np.uint32).tobytes()


class _Module:
    """The declarations of a module. `added`: what the code that is `rewritten` needs besides."""

    def __init__(self, declarations: list[Words], bound: int) -> None:
        self.bound = bound
        self.added: list[Words] = []
        self._types = {words[1]: words for words in declarations if spv.opcode(words) in spv.TYPES}
        self._constants = {words[2]: words[3] for words in declarations if spv.opcode(words) == spv.OP_CONSTANT}
        # The types of pointers, and of the values that are pointers.
        self._pointers = {
            (words[2], words[3]): number
            for number, words in self._types.items()
            if spv.opcode(words) == spv.OP_TYPE_POINTER
        }
        self._type_of = {words[2]: words[1] for words in declarations if spv.opcode(words) == spv.OP_VARIABLE}
        self._components: dict[int, tuple[int, int, int]] = {}  # the vector's type, a pointer to it, and the index

    def rewritten(self, words: Words) -> list[Words]:
        """The instructions for one of a function."""
        op = spv.opcode(words)
        if op == spv.OP_LOAD and words[3] in self._components:
            vector, pointer, index = self._components[words[3]]
            operands = words[4:]
            if operands and operands[0] & spv.MEMORY_ALIGNED:
                operands[1] = self._types[words[1]][2] // 8  # the vector is aligned as its scalars are
            load = spv.encoded(spv.OP_LOAD, vector, self._new_id(), pointer, *operands)
            return [load, spv.encoded(spv.OP_VECTOR_EXTRACT_DYNAMIC, *words[1:3], load[2], index)]
        if len(words) < 3 or words[1] not in self._types:
            return [words]
        self._type_of[words[2]] = words[1]
        vector = self._vector_of(words) if op in _CHAINS else 0
        if not vector:
            return [words]
        pointer = self._new_id()
        kind = self._pointer(self._types[words[1]][2], vector)
        self._components[words[2]] = vector, pointer, words[-1]
        return [spv.encoded(op, kind, pointer, *words[3:-1]), words]

    def _vector_of(self, chain: Words) -> int:
        """The type of the vector in a buffer to whose component a chain leads; 0 where it leads elsewhere."""
        _, storage, kind = self._types[self._type_of[chain[3]]][1:]
        if storage not in _BUFFERS:
            return 0
        for index in chain[4:]:
            words = self._types[kind]
            if spv.opcode(words) == spv.OP_TYPE_VECTOR:
                return kind
            kind = words[2 + self._constants[index]] if spv.opcode(words) == spv.OP_TYPE_STRUCT else words[2]
        return 0

    def _pointer(self, storage: int, content: int) -> int:
        if (storage, content) not in self._pointers:
            made = self._pointers[storage, content] = self._new_id()
            self.added.append(spv.encoded(spv.OP_TYPE_POINTER, made, storage, content))
        return self._pointers[storage, content]

    def _new_id(self) -> int:
        self.bound += 1
        return self.bound - 1
