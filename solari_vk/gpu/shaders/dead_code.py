"""Removes from a SPIR-V module what its entry points don't reach: blocks, functions, variables, types, constants.

Most shaders are compiled without shaderc's optimizer, which takes up to ten seconds and saves drivers no time. But
reflection and pipeline layouts must not see bindings that a shader includes and never uses.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from solari_vk.gpu.shaders import spv
from solari_vk.gpu.shaders.branches import without_constant_branches
from solari_vk.gpu.shaders.spv import Words

# Names and decorations of ids or of their members. Names stay only for what the module's interface needs, decorations
# also for values in functions: `precise` is one.
_NAMES = frozenset((spv.OP_NAME, spv.OP_MEMBER_NAME, spv.OP_TYPE_FORWARD_POINTER))
_DECORATIONS = frozenset((spv.OP_DECORATE, spv.OP_MEMBER_DECORATE, spv.OP_DECORATE_ID))
_RAY_QUERY_EXTENSION = b"SPV_KHR_ray_query\0"

# Where operands are ids, as (first word, end), by opcode. Other operands of these instructions are literals, and all
# operands of instructions that aren't listed are ids.
_IDS = {
    21: (2, 2), 22: (2, 2), 23: (2, 3), 24: (2, 3), 25: (2, 3),  # types: integer, float, vector, matrix, image
    32: (3, 4), 43: (1, 2), 50: (1, 2), spv.OP_VARIABLE: (1, 2),  # pointer; constant, specialization constant; variable
    spv.OP_FUNCTION: (1, 2), 61: (1, 4), 62: (1, 3), 63: (1, 3),  # function; load, store, copy
    79: (1, 5), 81: (1, 4), 82: (1, 5),  # shuffle, extract, insert
    246: (1, 1), 247: (1, 1), 248: (1, 1), 249: (1, 1), 250: (1, 2), 251: (1, 2),  # merges, label, branches
}  # fmt: skip
# The word that is a literal among ids: the number of an extended instruction in its set; the mask of operands of images
# (OpImageSample* and OpImageFetch, then those with a reference or component, OpImageWrite), behind which ids follow.
_LITERAL = {
    spv.OP_EXT_INST: 4,
    spv.OP_IMAGE_WRITE: 4,
    **dict.fromkeys((87, 88, 91, 92, 95, 98), 5),
    **dict.fromkeys((89, 90, 93, 94, 96, 97), 6),
}


def without_texts(spirv: bytes) -> bytes:
    """The module without source text, file names and lines, but for strings that debug information needs."""
    found = list(spv.instructions(spirv))
    imported = [spv.text(words[2:]) for words in found if spv.opcode(words) == spv.OP_EXT_INST_IMPORT]
    needs_strings = any(name.startswith("NonSemantic.") for name in imported)
    dropped = spv.TEXTS - {spv.OP_STRING} if needs_strings else spv.TEXTS
    return _joined(spirv, (words for words in found if spv.opcode(words) not in dropped))


def without_dead_code(spirv: bytes) -> bytes:
    """The module with what its entry points reach, and without names of local variables."""
    defined, functions, declarations = _definitions(_instructions(spirv))
    functions = without_constant_branches(functions, declarations)
    live = _reached(defined, functions, declarations)
    # The driver would refuse a module whose capability it lacks, even if only dead code needed it.
    traces = any(spv.opcode(defined[reached]) == spv.OP_TYPE_RAY_QUERY for reached in live)
    code = [words for number, body in functions.items() if number in live for words in body]
    # The second or third word of an instruction in a function is its result, which may be decorated.
    decorated = live.union(*(words[1:3] for words in code))
    live_declarations = [words for words in declarations if _stays(words, live, decorated, traces)]
    live_declarations = [
        _with_interface(words, live) if spv.opcode(words) == spv.OP_ENTRY_POINT else words
        for words in live_declarations
    ]
    return _joined(spirv, (*live_declarations, *code))


def _reached(defined: dict[int, Words], functions: dict[int, list[Words]], declarations: list[Words]) -> set[int]:
    """The ids of module scope that entry points and their execution modes lead to."""
    waiting: Words = []
    for words in declarations:
        if spv.opcode(words) == spv.OP_ENTRY_POINT:
            waiting.append(words[2])
        elif spv.opcode(words) == spv.OP_EXECUTION_MODE_ID:
            waiting += words[3:]
    live = set[int]()
    while waiting:
        reached = waiting.pop()
        if reached in live or reached not in defined:
            continue
        live.add(reached)
        for words in functions.get(reached, [defined[reached]]):
            waiting += _ids(words)
    return live


def _joined(spirv: bytes, listed: Iterable[Words]) -> bytes:
    words = [word for instruction in listed for word in instruction]
    return spirv[:20] + np.array(words, np.uint32).tobytes()


def _instructions(spirv: bytes) -> Iterator[Words]:
    """The words of each instruction but those about the source; the first holds the length above 16 bits of opcode."""
    for words in spv.instructions(spirv):
        if spv.opcode(words) not in spv.TEXTS:
            yield words


def _definitions(listed: Iterable[Words]) -> tuple[dict[int, Words], dict[int, list[Words]], list[Words]]:
    """What defines each id of module scope; the instructions of each function; the declarations before them."""
    defined: dict[int, Words] = {}
    functions: dict[int, list[Words]] = {}
    declarations: list[Words] = []
    body = declarations
    for words in listed:
        op = spv.opcode(words)
        if op == spv.OP_FUNCTION:
            body = functions[words[2]] = []
        if body is declarations or op == spv.OP_FUNCTION:
            result = _result(op)
            if result:
                defined[words[result]] = words
        body.append(words)
    return defined, functions, declarations


def _result(op: int) -> int:
    """The word that holds the id which a declaration or function defines; 0 if it defines none."""
    if op in spv.TYPES or op == spv.OP_EXT_INST_IMPORT:
        return 1
    # Constants of all kinds, from OpConstantTrue to OpSpecConstantOp, have their type before the result.
    constants = range(spv.OP_CONSTANT_TRUE, spv.OP_SPEC_CONSTANT_OP + 1)
    return 2 if op in (spv.OP_UNDEF, *constants, spv.OP_VARIABLE, spv.OP_FUNCTION) else 0


def _ids(words: Words) -> Words:
    """The ids in an instruction, of module scope or local."""
    op = spv.opcode(words)
    if op == spv.OP_EXT_INST_IMPORT:
        return []
    first, end = _IDS.get(op, (1, len(words)))
    found = words[first:end]
    if op in (spv.OP_FUNCTION, spv.OP_VARIABLE):
        found += words[4:]  # the function's type; the initial value
    if op in _LITERAL and len(words) > _LITERAL[op]:
        del found[_LITERAL[op] - 1]
    return found


def _stays(words: Words, live: set[int], decorated: set[int], traces: bool) -> bool:
    op = spv.opcode(words)
    if op == spv.OP_CAPABILITY:
        return traces or words[1] != spv.CAPABILITY_RAY_QUERY
    if op == spv.OP_EXTENSION:
        return traces or not np.array(words[1:], np.uint32).tobytes().startswith(_RAY_QUERY_EXTENSION)
    if op in _NAMES or op in _DECORATIONS:
        return words[1] in (live if op in _NAMES else decorated)
    result = _result(op)
    return not result or words[result] in live


def _with_interface(words: Words, live: set[int]) -> Words:
    """An entry point that names only live variables."""
    # The name is a string of words, the last of which ends with a zero byte; ids of variables follow.
    name_end = next(at for at in range(3, len(words)) if words[at] >> 24 == 0) + 1
    named = words[:name_end] + [word for word in words[name_end:] if word in live]
    return spv.encoded(spv.OP_ENTRY_POINT, *named[1:])
