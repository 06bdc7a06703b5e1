"""A SPIR-V module whose specialization constants have their values, without the code that these switch off.

Software drivers translate and optimize a whole module before they drop what constants switch off: without that code
they create the pipelines of a scene with few features in about half of the time.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from solari_vk.gpu.shaders import spv
from solari_vk.gpu.shaders.dead_code import without_dead_code
from solari_vk.gpu.shaders.module import Module
from solari_vk.gpu.shaders.spv import Words

# Making a smaller module takes milliseconds itself, which few switches don't win back.
_FEW_SWITCHES = 3
_BOOLEANS = {True: spv.OP_CONSTANT_TRUE, False: spv.OP_CONSTANT_FALSE}
# The operations on specialization constants by which shaders combine switches.
_CONDITIONS: dict[int, Callable[..., Any]] = {
    spv.OP_LOGICAL_EQUAL: operator.eq,
    spv.OP_LOGICAL_NOT_EQUAL: operator.ne,
    spv.OP_LOGICAL_OR: operator.or_,
    spv.OP_LOGICAL_AND: operator.and_,
    spv.OP_LOGICAL_NOT: operator.not_,
    spv.OP_I_EQUAL: operator.eq,
    spv.OP_I_NOT_EQUAL: operator.ne,
}


def has_many_switches(module: Module) -> bool:
    """Whether a module becomes much smaller: of scenes without features, modules have few boolean constants."""
    return sum(isinstance(constant.default, bool) for constant in module.constants.values()) > _FEW_SWITCHES


def specialized(module: Module, values: Mapping[str, int | float | bool]) -> Module:
    """The module with these values of specialization constants, by name; those without one have their defaults."""
    known = module.constants
    numbers = tuple(
        (known[name].id, np.array(value, known[name].dtype).tobytes())
        for name, value in values.items()
        if name in known
    )
    return replace(module, spirv=_specialized(module.spirv, numbers))


@lru_cache(maxsize=64)
def _specialized(spirv: bytes, numbers: tuple[tuple[int, bytes], ...]) -> bytes:
    """The module with the bytes of constants, by their specialization ids."""
    folding = _Folding(dict(numbers))
    declarations: list[int] = []
    at = spv.HEADER_WORDS
    for words in spv.instructions(spirv):
        if spv.opcode(words) == spv.OP_FUNCTION:
            break
        declarations += folding.folded(words)
        at += len(words)
    return without_dead_code(spirv[:20] + np.array(declarations, np.uint32).tobytes() + spirv[4 * at :])


class _Folding:
    """Makes constants of specialization constants, in the order of a module's declarations. values: their bytes, by
    specialization ids; those without have their defaults."""

    def __init__(self, values: Mapping[int, bytes]) -> None:
        self._values = values
        self._spec_ids: dict[int, int] = {}  # of ids
        self._known: dict[int, Any] = {}  # values of ids: booleans, and the words of 32-bit numbers

    def folded(self, words: Words) -> Words:
        """What takes the place of a declaration."""
        op = spv.opcode(words)
        operands = words[1:]
        if op == spv.OP_DECORATE and operands[1] == spv.DECORATION_SPEC_ID:
            self._spec_ids[operands[0]] = operands[2]
            return []
        if op in (spv.OP_SPEC_CONSTANT_TRUE, spv.OP_SPEC_CONSTANT_FALSE):
            value = self._value_of(operands[1])
            holds = op == spv.OP_SPEC_CONSTANT_TRUE if value is None else any(value)
            op = _BOOLEANS[holds]
        elif op == spv.OP_SPEC_CONSTANT:
            op = spv.OP_CONSTANT
            value = self._value_of(operands[1])
            if value is not None:
                operands[2:] = np.frombuffer(value, np.uint32).tolist()
        elif op == spv.OP_SPEC_CONSTANT_OP and operands[2] in _CONDITIONS and self._known.keys() >= set(operands[3:]):
            holds = _CONDITIONS[operands[2]](*(self._known[operand] for operand in operands[3:]))
            op = _BOOLEANS[bool(holds)]
            operands = operands[:2]
        # Constants that others are computed of; wider numbers than 32 bits switch nothing.
        if op in _BOOLEANS.values():
            self._known[operands[1]] = op == spv.OP_CONSTANT_TRUE
        elif op == spv.OP_CONSTANT and len(operands) == 3:
            self._known[operands[1]] = operands[2]
        return spv.encoded(op, *operands)

    def _value_of(self, constant: int) -> bytes | None:
        return self._values.get(self._spec_ids.get(constant, -1))
