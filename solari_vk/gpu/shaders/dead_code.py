"""Removes from a SPIR-V module what its entry points don't reach: blocks, functions, variables, types, constants.

Most shaders are compiled without shaderc's optimizer, which takes up to ten seconds and saves drivers no time. But
reflection and pipeline layouts must not see bindings that a shader includes and never uses.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from solari_vk.gpu.shaders.branches import without_constant_branches
from solari_vk.gpu.shaders.ray_generation import instructions

_EXTENSION, _CAPABILITY, _EXT_INST_IMPORT, _EXT_INST, _ENTRY_POINT, _MODE_ID = 10, 17, 11, 12, 15, 331
_FUNCTION, _VARIABLE, _FORWARD_POINTER = 54, 59, 39
_NAMES, _DECORATIONS = frozenset((5, 6, _FORWARD_POINTER)), frozenset((71, 72, 332))  # of ids or their members
_TEXTS = frozenset((2, 3, 4, 7, 8, 317, 330))  # sources, file names, lines: shipped modules must not contain paths
_RAY_QUERY, _RAY_QUERY_TYPE, _RAY_QUERY_EXTENSION = 4472, 4472, b"SPV_KHR_ray_query\0"
_TYPES = frozenset((*range(19, 34), _RAY_QUERY_TYPE, 5341))

# Where operands are ids, as (first word, end). Other operands of these instructions are literals, and all operands of
# instructions that aren't listed are ids.
_IDS = {
    21: (2, 2), 22: (2, 2), 23: (2, 3), 24: (2, 3), 25: (2, 3),  # types: integer, float, vector, matrix, image
    32: (3, 4), 43: (1, 2), 50: (1, 2), _VARIABLE: (1, 2),  # pointer; constant, specialization constant; variable
    _FUNCTION: (1, 2), 61: (1, 4), 62: (1, 3), 63: (1, 3),  # function; load, store, copy
    79: (1, 5), 81: (1, 4), 82: (1, 5),  # shuffle, extract, insert
    246: (1, 1), 247: (1, 1), 248: (1, 1), 249: (1, 1), 250: (1, 2), 251: (1, 2),  # merges, label, branches
}  # fmt: skip
# The literal among the ids: the instruction's number in its set, an image's operands
_LITERAL = {
    _EXT_INST: 4,
    99: 4,
    **dict.fromkeys((87, 88, 91, 92, 95, 98), 5),
    **dict.fromkeys((89, 90, 93, 94, 96, 97), 6),
}

Words = list[int]


def without_texts(spirv: bytes) -> bytes:
    """The module without source text, file names and lines."""
    return _joined(spirv, _instructions(spirv))


def without_dead_code(spirv: bytes) -> bytes:
    """The module with what its entry points reach, and without names of local variables."""
    defined, functions, declarations = _definitions(_instructions(spirv))
    functions = without_constant_branches(functions, declarations)
    live = set[int]()
    waiting = [words[2] for words in declarations if words[0] & 0xFFFF == _ENTRY_POINT]
    waiting += [word for words in declarations if words[0] & 0xFFFF == _MODE_ID for word in words[3:]]
    while waiting:
        reached = waiting.pop()
        if reached not in live and reached in defined:
            live.add(reached)
            for words in functions.get(reached, [defined[reached]]):
                waiting += _ids(words)
    traces = any(defined[reached][0] & 0xFFFF == _RAY_QUERY_TYPE for reached in live)
    code = [words for number, body in functions.items() if number in live for words in body]
    decorated = live.union(*(words[1:3] for words in code))  # with the results of the code, of which some are `precise`
    kept = [words for words in declarations if _stays(words, live, decorated, traces)]
    kept = [_with_interface(words, live) if words[0] & 0xFFFF == _ENTRY_POINT else words for words in kept]
    return _joined(spirv, (*kept, *code))


def _joined(spirv: bytes, listed: Iterable[Words]) -> bytes:
    words = [word for instruction in listed for word in instruction]
    return spirv[:20] + np.array(words, np.uint32).tobytes()


def _instructions(spirv: bytes) -> Iterator[Words]:
    """The words of each instruction but those about the source; the first holds the length above 16 bits of opcode."""
    for words in instructions(spirv):
        if words[0] & 0xFFFF not in _TEXTS:
            yield words


def _definitions(listed: Iterable[Words]) -> tuple[dict[int, Words], dict[int, list[Words]], list[Words]]:
    """What defines each id of module scope; the instructions of each function; the declarations before them."""
    defined: dict[int, Words] = {}
    functions: dict[int, list[Words]] = {}
    declarations: list[Words] = []
    body = declarations
    for words in listed:
        op = words[0] & 0xFFFF
        if op == _FUNCTION:
            body = functions[words[2]] = []
        if body is declarations or op == _FUNCTION:
            result = _result(op)
            if result:
                defined[words[result]] = words
        body.append(words)
    return defined, functions, declarations


def _result(op: int) -> int:
    """The word that holds the id which a declaration or function defines; 0 if it defines none."""
    if op in _TYPES or op == _EXT_INST_IMPORT:
        return 1
    return 2 if op in (1, *range(41, 53), _VARIABLE, _FUNCTION) else 0


def _ids(words: Words) -> Words:
    """The ids in an instruction, of module scope or local."""
    op = words[0] & 0xFFFF
    if op == _EXT_INST_IMPORT:
        return []
    first, end = _IDS.get(op, (1, len(words)))
    found = words[first:end]
    if op in (_FUNCTION, _VARIABLE):
        found += words[4:]  # the function's type; the initial value
    if op in _LITERAL and len(words) > _LITERAL[op]:
        del found[_LITERAL[op] - 1]
    return found


def _stays(words: Words, live: set[int], decorated: set[int], traces: bool) -> bool:
    op = words[0] & 0xFFFF
    if op == _CAPABILITY:
        return traces or words[1] != _RAY_QUERY
    if op == _EXTENSION:
        return traces or not np.array(words[1:], np.uint32).tobytes().startswith(_RAY_QUERY_EXTENSION)
    if op in _NAMES or op in _DECORATIONS:
        return words[1] in (live if op in _NAMES else decorated)
    result = _result(op)
    return not result or words[result] in live


def _with_interface(words: Words, live: set[int]) -> Words:
    """An entry point that names only live variables."""
    name_end = next(at for at in range(3, len(words)) if words[at] >> 24 == 0) + 1
    kept = words[:name_end] + [word for word in words[name_end:] if word in live]
    return [len(kept) << 16 | _ENTRY_POINT, *kept[1:]]
