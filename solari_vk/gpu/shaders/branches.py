"""Removes from the functions of a SPIR-V module the blocks that constant conditions never run.

Features of scenes are constants in shaders, `false` in modules for scenes without them. Conditions are followed through
`&&`, `||` and `!`, local variables that are only ever given one constant, and functions that return one.
"""

from __future__ import annotations

from collections.abc import Mapping

Words = list[int]
Block = list[Words]  # a label first, a terminator last
Functions = Mapping[int, list[Words]]
Values = Mapping[int, bool]  # of what was found constant

_CONSTANTS = {41: True, 42: False}
_CALL, _VARIABLE, _LOAD, _STORE = 57, 59, 61, 62
_OR, _AND, _NOT, _PHI = 166, 167, 168, 245
_LOOP_MERGE, _SELECTION_MERGE, _LABEL, _BRANCH, _BRANCH_IF, _SWITCH = 246, 247, 248, 249, 250, 251
_RETURN_VALUE, _UNREACHABLE, _FUNCTION_END = 254, 255, 56


def without_constant_branches(functions: Functions, declarations: list[Words]) -> dict[int, list[Words]]:
    """The instructions of each function; declarations are those of constants, at least.

    A block that a merge instruction names stays, though empty, when nothing runs it.
    """
    known = {words[2]: value for words in declarations if (value := _CONSTANTS.get(_op(words))) is not None}
    bodies = {number: _blocks(body) for number, body in functions.items()}
    returned: dict[int, bool] = {}
    waiting = set(bodies)
    while waiting:  # a function whose result is found constant may change its callers
        found = set[int]()
        for number in waiting:
            head, blocks = bodies[number]
            bodies[number] = head, blocks = head, _pruned(blocks, known, returned)
            values = {known.get(words[1]) for block in blocks for words in block if _op(words) == _RETURN_VALUE}
            if number not in returned and len(values) == 1 and (value := values.pop()) is not None:
                returned[number] = value
                found.add(number)
        waiting = {number for number, (_, blocks) in bodies.items() if not found.isdisjoint(_called(blocks))}
    return {number: [*head, *_used(blocks), [1 << 16 | _FUNCTION_END]] for number, (head, blocks) in bodies.items()}


def _called(blocks: list[Block]) -> Words:
    """The functions that are called."""
    return [words[3] for block in blocks for words in block if _op(words) == _CALL]


def _used(blocks: list[Block]) -> list[Words]:
    """The instructions of all blocks but the local variables that none of them names."""
    code = [words for block in blocks for words in block]
    named = {word for words in code if _op(words) != _VARIABLE for word in words[1:]}
    return [words for words in code if _op(words) != _VARIABLE or words[2] in named]


def _op(words: Words) -> int:
    return words[0] & 0xFFFF


def _blocks(body: list[Words]) -> tuple[list[Words], list[Block]]:
    """The function and its parameters, and its blocks; without the end of the function."""
    starts = [at for at, words in enumerate(body) if _op(words) == _LABEL]
    ends = [*starts[1:], len(body) - 1]
    return body[: starts[0]], [body[start:end] for start, end in zip(starts, ends, strict=True)]


def _pruned(blocks: list[Block], known: dict[int, bool], returned: Values) -> list[Block]:
    """The blocks of a function that may run. Adds to `known` the values found constant."""
    while True:
        size, count = len(known), len(blocks)
        stored = _stored(blocks, known)
        loops = {block[0][1] for block in blocks if _starts_loop(block)}
        for block in blocks:
            for words in block:
                value = _value(words, known, stored, returned)
                if value is not None:
                    known[words[2]] = value
            _straighten(block, known, loops)
        blocks = _reached(blocks)
        if (size, count) == (len(known), len(blocks)):
            return blocks


def _stored(blocks: list[Block], known: Values) -> Values:
    """The local variables that hold nothing but one constant."""
    values: dict[int, list[bool | None]] = {}  # of each variable, without repetition
    for block in blocks:
        for words in block:
            op = _op(words)
            if op == _VARIABLE and len(words) == 4:
                values[words[2]] = []
            elif op == _STORE and words[1] in values:
                if (value := known.get(words[2])) not in values[words[1]]:
                    values[words[1]].append(value)
            elif op != _LOAD:
                for word in words[1:]:
                    values.pop(word, None)  # it is written in another way, or the word is a literal of this number
    return {variable: of[0] for variable, of in values.items() if len(of) == 1 and of[0] is not None}


def _value(words: Words, known: Values, stored: Values, returned: Values) -> bool | None:
    """What an instruction results in, if it is a constant condition."""
    op = _op(words)
    if op == _LOAD:
        return stored.get(words[3])
    if op == _CALL:
        return returned.get(words[3])
    if op == _NOT:
        value = known.get(words[3])
        return None if value is None else not value
    if op not in (_AND, _OR, _PHI):
        return None
    values = {known.get(word) for word in (words[3::2] if op == _PHI else words[3:])}
    if op != _PHI and (op == _OR) in values:
        return op == _OR
    return values.pop() if len(values) == 1 else None


def _starts_loop(block: Block) -> bool:
    return len(block) > 1 and _op(block[-2]) == _LOOP_MERGE


def _straighten(block: Block, known: Values, loops: set[int]) -> None:
    """A branch by a constant becomes one without condition, unless that would take a loop its way back."""
    last = block[-1]
    if _op(last) == _BRANCH_IF and (value := known.get(last[1])) is not None and last[3 if value else 2] not in loops:
        merge = len(block) > 1 and _op(block[-2]) == _SELECTION_MERGE
        block[-1 - merge :] = [[2 << 16 | _BRANCH, last[2 if value else 3]]]


def _successors(block: Block) -> Words:
    last = block[-1]
    targets = {_BRANCH: last[1:2], _BRANCH_IF: last[2:4], _SWITCH: [*last[2:3], *last[4::2]]}
    return targets.get(_op(last), [])


def _reached(blocks: list[Block]) -> list[Block]:
    """The blocks that the first one leads to, with the values from their predecessors."""
    at = {block[0][1]: block for block in blocks}
    live, waiting = set[int](), [blocks[0][0][1]]
    while waiting:
        label = waiting.pop()
        if label not in live:
            live.add(label)
            waiting += _successors(at[label])
            if _starts_loop(at[label]) and any(_op(words) == _PHI for words in at[label]):
                waiting.append(at[label][-2][2])  # whose values the loop's head names
    for label in list(live):
        merge = at[label][-2] if len(at[label]) > 1 else []
        if merge and _op(merge) in (_LOOP_MERGE, _SELECTION_MERGE):
            if merge[1] not in live:
                at[merge[1]][1:] = [[1 << 16 | _UNREACHABLE]]
            if _op(merge) == _LOOP_MERGE and merge[2] not in live:
                at[merge[2]][1:] = [[2 << 16 | _BRANCH, label]]
            live.update(merge[1 : 3 if _op(merge) == _LOOP_MERGE else 2])
    kept = [block for block in blocks if block[0][1] in live]
    before: dict[int, set[int]] = {label: set() for label in live}
    for block in kept:
        for target in _successors(block):
            before[target].add(block[0][1])
    for block in kept:
        block[:] = [_phi(words, before[block[0][1]]) if _op(words) == _PHI else words for words in block]
    return _joined(kept, before)


def _joined(blocks: list[Block], before: Mapping[int, set[int]]) -> list[Block]:
    """Blocks that one other block leads to, and only to them, continue it, unless a merge instruction names them."""
    named = {
        label
        for block in blocks
        for words in block[-2:-1]
        for label in words[1 : {_LOOP_MERGE: 3, _SELECTION_MERGE: 2}.get(_op(words), 0)]
    }
    into: dict[int, Block] = {}  # the block that now holds what a label began
    kept = []
    for block in blocks:
        label = block[0][1]
        first = into.get(next(iter(before[label]))) if len(before[label]) == 1 and label not in named else None
        if first and _op(first[-1]) == _BRANCH and _op(first[-2]) != _LOOP_MERGE and _op(block[1]) != _PHI:
            first[-1:] = block[1:]
            into[label] = first
        else:
            into[label] = block
            kept.append(block)
    for block in kept:
        block[:] = [_renamed(words, into) if _op(words) == _PHI else words for words in block]
    return kept


def _renamed(words: Words, into: Mapping[int, Block]) -> Words:
    """A choice by predecessors, which are now parts of other blocks."""
    return [*words[:3], *(word if at % 2 == 0 else into[word][0][1] for at, word in enumerate(words[3:]))]


def _phi(words: Words, before: set[int]) -> Words:
    pairs = [pair for pair in zip(words[3::2], words[4::2], strict=True) if pair[1] in before]
    kept = [*words[1:3], *(word for pair in pairs for word in pair)]
    return [(len(kept) + 1) << 16 | _PHI, *kept]
