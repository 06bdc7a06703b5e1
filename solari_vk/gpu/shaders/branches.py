"""Removes from the functions of a SPIR-V module the blocks that constant conditions never run.

Features of scenes are constants in shaders, `false` in modules for scenes without them. Conditions are followed through
`&&`, `||` and `!`, local variables that are only ever given one constant, and functions that return one.
"""

from __future__ import annotations

from collections.abc import Mapping

from solari_vk.gpu.shaders import spv
from solari_vk.gpu.shaders.spv import Words

Block = list[Words]  # a label first, a terminator last
Functions = Mapping[int, list[Words]]
Values = Mapping[int, bool]  # of what was found constant

_CONSTANTS = {spv.OP_CONSTANT_TRUE: True, spv.OP_CONSTANT_FALSE: False}


def without_constant_branches(functions: Functions, declarations: list[Words]) -> dict[int, list[Words]]:
    """The instructions of each function; declarations are those of constants, at least.

    A block that a merge instruction names stays, though empty, when nothing runs it.
    """
    known = {words[2]: _CONSTANTS[spv.opcode(words)] for words in declarations if spv.opcode(words) in _CONSTANTS}
    heads: dict[int, list[Words]] = {}
    blocks: dict[int, list[Block]] = {}
    for number, body in functions.items():
        heads[number], blocks[number] = _blocks(body)
    returned: dict[int, bool] = {}
    waiting = set(functions)
    while waiting:
        found = set[int]()
        for number in waiting:
            blocks[number] = _pruned(blocks[number], known, returned)
            value = _returned(blocks[number], known)
            if number not in returned and value is not None:
                returned[number] = value
                found.add(number)
        # A function whose result was found constant may change its callers.
        waiting = {number for number, its_blocks in blocks.items() if not found.isdisjoint(_called(its_blocks))}
    end = spv.encoded(spv.OP_FUNCTION_END)
    return {number: [*head, *_used(blocks[number]), end] for number, head in heads.items()}


def _returned(blocks: list[Block], known: Values) -> bool | None:
    """The constant that a function returns wherever it returns a value; None if there is none."""
    returns = [words[1] for block in blocks for words in block if spv.opcode(words) == spv.OP_RETURN_VALUE]
    values = {known.get(result) for result in returns}
    return values.pop() if len(values) == 1 else None


def _called(blocks: list[Block]) -> Words:
    """The functions that are called."""
    return [words[3] for block in blocks for words in block if spv.opcode(words) == spv.OP_FUNCTION_CALL]


def _used(blocks: list[Block]) -> list[Words]:
    """The instructions of all blocks but the local variables that none of them names."""
    code = [words for block in blocks for words in block]
    named = {word for words in code if spv.opcode(words) != spv.OP_VARIABLE for word in words[1:]}
    return [words for words in code if spv.opcode(words) != spv.OP_VARIABLE or words[2] in named]


def _blocks(body: list[Words]) -> tuple[list[Words], list[Block]]:
    """The function and its parameters, and its blocks; without the end of the function."""
    starts = [at for at, words in enumerate(body) if spv.opcode(words) == spv.OP_LABEL]
    ends = [*starts[1:], len(body) - 1]
    return body[: starts[0]], [body[start:end] for start, end in zip(starts, ends, strict=True)]


def _pruned(blocks: list[Block], known: dict[int, bool], returned: Values) -> list[Block]:
    """The blocks of a function that may run. Adds to `known` the values found constant."""
    while True:
        value_count = len(known)
        block_count = len(blocks)
        stored = _stored(blocks, known)
        loops = {block[0][1] for block in blocks if _starts_loop(block)}
        for block in blocks:
            _find_values(block, known, stored, returned)
            _straighten(block, known, loops)
        blocks = _reached(blocks)
        # A block that is gone may leave a variable with one constant, which decides more branches.
        if len(known) == value_count and len(blocks) == block_count:
            return blocks


def _find_values(block: Block, known: dict[int, bool], stored: Values, returned: Values) -> None:
    """Add to `known` the results of a block's instructions that are constant conditions."""
    for words in block:
        value = _value(words, known, stored, returned)
        if value is not None:
            known[words[2]] = value


def _stored(blocks: list[Block], known: Values) -> Values:
    """The local variables that hold nothing but one constant."""
    values: dict[int, set[bool | None]] = {}  # that are stored to each variable
    for words in (words for block in blocks for words in block):
        op = spv.opcode(words)
        if op == spv.OP_VARIABLE and len(words) == 4:  # without an initial value
            values[words[2]] = set()
            continue
        if op == spv.OP_STORE and words[1] in values:
            values[words[1]].add(known.get(words[2]))
            continue
        if op == spv.OP_LOAD:
            continue
        # The variable may be written in another way. The word may also be a literal of the same number, which costs a
        # chance to simplify and nothing else.
        for word in words[1:]:
            values.pop(word, None)
    constant: dict[int, bool] = {}
    for variable, stored in values.items():
        value = stored.pop() if len(stored) == 1 else None
        if value is not None:
            constant[variable] = value
    return constant


def _value(words: Words, known: Values, stored: Values, returned: Values) -> bool | None:
    """What an instruction results in, if it is a constant condition."""
    op = spv.opcode(words)
    if op == spv.OP_LOAD:
        return stored.get(words[3])
    if op == spv.OP_FUNCTION_CALL:
        return returned.get(words[3])
    if op == spv.OP_LOGICAL_NOT:
        value = known.get(words[3])
        return None if value is None else not value
    if op not in (spv.OP_LOGICAL_AND, spv.OP_LOGICAL_OR, spv.OP_PHI):
        return None
    # A phi has pairs of a value and the label of a predecessor.
    values = {known.get(word) for word in (words[3::2] if op == spv.OP_PHI else words[3:])}
    decides = op == spv.OP_LOGICAL_OR  # true decides `||`, and false `&&`, whatever the other operand is
    if op != spv.OP_PHI and decides in values:
        return decides
    return values.pop() if len(values) == 1 else None


def _starts_loop(block: Block) -> bool:
    return len(block) > 1 and spv.opcode(block[-2]) == spv.OP_LOOP_MERGE


def _straighten(block: Block, known: Values, loops: set[int]) -> None:
    """A branch by a constant becomes one without condition, unless that would take a loop its way back: SPIR-V wants
    exactly one branch back to each loop's head."""
    last = block[-1]
    if spv.opcode(last) != spv.OP_BRANCH_CONDITIONAL or last[1] not in known:
        return
    target, other = last[2:4] if known[last[1]] else last[3:1:-1]
    if other in loops:
        return
    has_merge = len(block) > 1 and spv.opcode(block[-2]) == spv.OP_SELECTION_MERGE
    replaced = 2 if has_merge else 1
    block[-replaced:] = [spv.encoded(spv.OP_BRANCH, target)]


def _successors(block: Block) -> Words:
    last = block[-1]
    targets = {
        spv.OP_BRANCH: last[1:2],
        spv.OP_BRANCH_CONDITIONAL: last[2:4],
        spv.OP_SWITCH: [*last[2:3], *last[4::2]],  # the default, then a literal and a label for each case
    }
    return targets.get(spv.opcode(last), [])


def _merge_labels(block: Block) -> Words:
    """The labels that a block's merge instruction names: the merge block, of a loop also the continue target."""
    merge = block[-2] if len(block) > 1 else [0]
    counts = {spv.OP_SELECTION_MERGE: 1, spv.OP_LOOP_MERGE: 2}
    return merge[1 : 1 + counts.get(spv.opcode(merge), 0)]


def _reached(blocks: list[Block]) -> list[Block]:
    """The blocks that the first one leads to, with the values from their predecessors."""
    at = {block[0][1]: block for block in blocks}
    live = _live_labels(at, blocks[0][0][1])
    for label in list(live):
        _empty_merges(at, label, live)
    live_blocks = [block for block in blocks if block[0][1] in live]
    before: dict[int, set[int]] = {label: set() for label in live}
    for block in live_blocks:
        for target in _successors(block):
            before[target].add(block[0][1])
    for block in live_blocks:
        predecessors = before[block[0][1]]
        block[:] = [_phi(words, predecessors) if spv.opcode(words) == spv.OP_PHI else words for words in block]
    return _joined(live_blocks, before)


def _live_labels(at: Mapping[int, Block], first: int) -> set[int]:
    """The labels of the blocks that may run."""
    live = set[int]()
    waiting = [first]
    while waiting:
        label = waiting.pop()
        if label in live:
            continue
        live.add(label)
        block = at[label]
        waiting += _successors(block)
        has_phi = any(spv.opcode(words) == spv.OP_PHI for words in block)
        if _starts_loop(block) and has_phi:
            # The phi names values of the continue target, which must stay even if no path leads there.
            waiting.append(block[-2][2])
    return live


def _empty_merges(at: Mapping[int, Block], label: int, live: set[int]) -> None:
    """Empty the blocks that a merge instruction names and nothing runs, and count them as live: SPIR-V wants them."""
    named = _merge_labels(at[label])
    if named and named[0] not in live:
        at[named[0]][1:] = [spv.encoded(spv.OP_UNREACHABLE)]
    if len(named) > 1 and named[1] not in live:
        at[named[1]][1:] = [spv.encoded(spv.OP_BRANCH, label)]  # a continue target leads to the loop's head
    live.update(named)


def _joined(blocks: list[Block], before: Mapping[int, set[int]]) -> list[Block]:
    """Blocks that one other block leads to, and only to them, continue it, unless a merge instruction names them."""
    named = {label for block in blocks for label in _merge_labels(block)}
    into: dict[int, Block] = {}  # the block that now holds what a label began
    joined = []
    for block in blocks:
        label = block[0][1]
        first = into.get(next(iter(before[label]))) if len(before[label]) == 1 else None
        if first is not None and label not in named and _may_continue(first, block):
            first[-1:] = block[1:]
            into[label] = first
        else:
            into[label] = block
            joined.append(block)
    for block in joined:
        block[:] = [_renamed(words, into) if spv.opcode(words) == spv.OP_PHI else words for words in block]
    return joined


def _may_continue(first: Block, block: Block) -> bool:
    """Whether a block may follow its only predecessor: one that leads to nothing else and begins no loop."""
    leads_on = spv.opcode(first[-1]) == spv.OP_BRANCH and spv.opcode(first[-2]) != spv.OP_LOOP_MERGE
    return leads_on and spv.opcode(block[1]) != spv.OP_PHI


def _renamed(words: Words, into: Mapping[int, Block]) -> Words:
    """A choice by predecessors, which are now parts of other blocks."""
    return [*words[:3], *(word if at % 2 == 0 else into[word][0][1] for at, word in enumerate(words[3:]))]


def _phi(words: Words, before: set[int]) -> Words:
    pairs = [pair for pair in zip(words[3::2], words[4::2], strict=True) if pair[1] in before]
    operands = [*words[1:3], *(word for pair in pairs for word in pair)]
    return spv.encoded(spv.OP_PHI, *operands)
