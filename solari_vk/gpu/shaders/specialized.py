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

from solari_vk.gpu.shaders.dead_code import without_dead_code
from solari_vk.gpu.shaders.module import Module
from solari_vk.gpu.shaders.spirv_code import OP_DECORATE, OP_FUNCTION

_FEW_SWITCHES = 3
_SPEC_ID = 1
_TRUE, _FALSE, _CONSTANT = 41, 42, 43
_SPEC_TRUE, _SPEC_FALSE, _SPEC_CONSTANT, _SPEC_OPERATION = 48, 49, 50, 52
_CONDITIONS: dict[int, Callable[..., Any]] = {
    164: operator.eq,
    165: operator.ne,
    166: operator.or_,
    167: operator.and_,
    168: operator.not_,  # of booleans
    170: operator.eq,
    171: operator.ne,  # of integers
}


def has_many_switches(module: Module) -> bool:
    """Whether a module becomes much smaller: of scenes without features, modules have few boolean constants."""
    return sum(isinstance(constant.default, bool) for constant in module.constants.values()) > _FEW_SWITCHES


def specialized(module: Module, values: Mapping[str, int | float | bool]) -> Module:
    """The module with these values of specialization constants, by name; those without one have their defaults."""
    known = module.constants
    given = tuple(
        (known[name].id, np.array(value, known[name].dtype).tobytes())
        for name, value in values.items()
        if name in known
    )
    return replace(module, spirv=_specialized(module.spirv, given))


@lru_cache(maxsize=64)
def _specialized(spirv: bytes, given: tuple[tuple[int, bytes], ...]) -> bytes:
    """The module with the bytes of constants, by their specialization ids."""
    values, ids, known = dict(given), dict[int, int](), dict[int, Any]()
    words, at = np.frombuffer(spirv, np.uint32).tolist(), 5
    declarations: list[int] = []
    while (op := words[at] & 0xFFFF) != OP_FUNCTION:
        start, at = at, at + (words[at] >> 16)
        operands = words[start + 1 : at]
        if op == OP_DECORATE and operands[1] == _SPEC_ID:
            ids[operands[0]] = operands[2]
            continue
        if op in (_SPEC_TRUE, _SPEC_FALSE):
            value = values.get(ids.get(operands[1], -1))
            op = _TRUE if (op == _SPEC_TRUE if value is None else any(value)) else _FALSE
        elif op == _SPEC_CONSTANT:
            value = values.get(ids.get(operands[1], -1))
            op, operands[2:] = _CONSTANT, operands[2:] if value is None else np.frombuffer(value, np.uint32).tolist()
        elif op == _SPEC_OPERATION and operands[2] in _CONDITIONS and known.keys() >= set(operands[3:]):
            holds = _CONDITIONS[operands[2]](*(known[operand] for operand in operands[3:]))
            op, operands = _TRUE if holds else _FALSE, operands[:2]
        if op in (_TRUE, _FALSE):
            known[operands[1]] = op == _TRUE
        elif op == _CONSTANT and len(operands) == 3:
            known[operands[1]] = operands[2]
        declarations += [(len(operands) + 1) << 16 | op, *operands]
    return without_dead_code(spirv[:20] + np.array(declarations, np.uint32).tobytes() + spirv[4 * at :])
