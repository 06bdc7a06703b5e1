"""SPIR-V that other compilers made, for passes: files, bytes, and what the compiler of Slang returns."""

from __future__ import annotations

from functools import cache

import numpy as np

from solari_vk.base.errors import SolariError, quoted
from solari_vk.gpu.shaders import dead_code, spv
from solari_vk.gpu.shaders.compiler import compile_shader
from solari_vk.gpu.shaders.spirv import reflect
from solari_vk.gpu.shaders.spirv_code import instructions

_COMPUTE = 5  # the execution model GLCompute
PASS_SET = 1  # of what isn't the package's
_LAYOUTS = ("passes/layout.comp", "scene/layout.comp")


@cache
def _sets() -> dict[str, int]:
    """The descriptor sets of what the package's shaders declare, by name."""
    modules = [reflect(compile_shader(path), path) for path in _LAYOUTS]
    return {name: binding.set for module in modules for name, binding in module.bindings.items()}


def prepared(spirv: bytes, name: str) -> bytes:
    """The module of a compute pass, whose entry point is called main, without texts, with the scene's resources in
    descriptor set 0 and all others in set 1. Raises SolariError for anything but one compute shader's SPIR-V, of which
    its frame is checked: what is in its functions must be valid."""
    if not isinstance(spirv, bytes) or len(spirv) % 4:
        raise SolariError(f"{name}: SPIR-V is bytes, a multiple of 4, not {quoted(spirv)}")
    instructions(spirv, name)  # that its words are whole
    found = list(spv.instructions(spirv))
    ops = [spv.opcode(words) for words in found]
    # Drivers crash where one is missing.
    if ops.count(spv.OP_FUNCTION) != ops.count(spv.OP_FUNCTION_END) or (ops and ops[-1] != spv.OP_FUNCTION_END):
        raise SolariError(f"{name}: the SPIR-V module is cut off: its last function has no end")
    entries = [words for words in found if spv.opcode(words) == spv.OP_ENTRY_POINT]
    called = ", ".join(spv.text(words[3:]) for words in entries)
    if not entries:
        raise SolariError(f"{name}: the SPIR-V module has no entry point")
    if len(entries) > 1 or entries[0][1] != _COMPUTE:
        raise SolariError(f"{name}: a pass runs one compute shader, and the entry points are {called}")
    names = {words[1]: spv.text(words[2:]) for words in found if spv.opcode(words) == spv.OP_NAME}
    code: list[int] = np.frombuffer(spirv, np.uint32)[: spv.HEADER_WORDS].tolist()
    for words in found:
        if spv.opcode(words) == spv.OP_ENTRY_POINT:
            words = _called_main(words)
        elif spv.opcode(words) == spv.OP_DECORATE and words[2] == spv.DECORATION_SET:
            words = [*words[:3], _sets().get(names.get(words[1], ""), PASS_SET)]
        code += words
    prepared = dead_code.without_texts(np.array(code, np.uint32).tobytes())
    if reflect(prepared, name).push_constants is not None:
        raise SolariError(f"{name}: frames set no push constants: declare a uniform block (in Slang a ConstantBuffer)")
    return prepared


def _called_main(words: list[int]) -> list[int]:
    """An entry point's instruction with the name main."""
    old = len(spv.text(words[3:]).encode()) // 4 + 1  # words, with the 0 at the end
    main = np.frombuffer(b"main\0\0\0\0", np.uint32).tolist()
    return spv.encoded(spv.OP_ENTRY_POINT, *words[1:3], *main, *words[3 + old :])
