"""SPIR-V's encoding (specification 1.6): opcodes and other numbers by their names, and the words of instructions.

A module is a header of five words and instructions. An instruction's first word holds its length in words, in the upper
16 bits, and its opcode. The operands follow: for what has a result first the id of its type, then that of the result.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

Words = list[int]

MAGIC = 0x07230203
HEADER_WORDS = 5
ID_BOUND = 3  # the word of the header that is larger than all ids

# Debug instructions. Names may be dropped; sources, files and lines (TEXTS) hold paths of the machine that compiled.
OP_SOURCE_CONTINUED = 2
OP_SOURCE = 3
OP_SOURCE_EXTENSION = 4
OP_NAME = 5
OP_MEMBER_NAME = 6
OP_STRING = 7
OP_LINE = 8
OP_NO_LINE = 317
OP_MODULE_PROCESSED = 330
TEXTS = frozenset(
    (OP_SOURCE_CONTINUED, OP_SOURCE, OP_SOURCE_EXTENSION, OP_STRING, OP_LINE, OP_NO_LINE, OP_MODULE_PROCESSED)
)

# How a module is used. A SPIR-V module begins with its capabilities.
OP_UNDEF = 1
OP_EXTENSION = 10
OP_EXT_INST_IMPORT = 11
OP_EXT_INST = 12  # of an imported set, such as GLSL.std.450
OP_MEMORY_MODEL = 14
OP_ENTRY_POINT = 15
OP_EXECUTION_MODE = 16
OP_EXECUTION_MODE_ID = 331  # whose operands are ids of constants, such as a local size that can be specialized
OP_CAPABILITY = 17
CAPABILITY_RAY_QUERY = 4472
CAPABILITY_PHYSICAL_ADDRESSES = 5347
ADDRESSING_PHYSICAL_64 = 5348
MODE_LOCAL_SIZE = 17
MODE_LOCAL_SIZE_ID = 38

# Decorations of an id, or of a member of a struct.
OP_DECORATE = 71
OP_MEMBER_DECORATE = 72
OP_DECORATE_ID = 332
DECORATION_SPEC_ID = 1
DECORATION_BLOCK = 2
DECORATION_ROW_MAJOR = 4
DECORATION_ARRAY_STRIDE = 6
DECORATION_MATRIX_STRIDE = 7
DECORATION_NON_WRITABLE = 24
DECORATION_NON_READABLE = 25
DECORATION_BINDING = 33
DECORATION_SET = 34
DECORATION_OFFSET = 35

# Types, all of whose opcodes but the last two lie in one range. Their first operand is the result.
OP_TYPE_VOID = 19
OP_TYPE_INT = 21
OP_TYPE_FLOAT = 22
OP_TYPE_VECTOR = 23
OP_TYPE_MATRIX = 24
OP_TYPE_IMAGE = 25
OP_TYPE_SAMPLER = 26
OP_TYPE_SAMPLED_IMAGE = 27
OP_TYPE_ARRAY = 28
OP_TYPE_RUNTIME_ARRAY = 29
OP_TYPE_STRUCT = 30
OP_TYPE_POINTER = 32
OP_TYPE_FUNCTION = 33
OP_TYPE_FORWARD_POINTER = 39
OP_TYPE_RAY_QUERY = 4472
OP_TYPE_ACCELERATION_STRUCTURE = 5341
TYPES = frozenset((*range(OP_TYPE_VOID, OP_TYPE_FUNCTION + 1), OP_TYPE_RAY_QUERY, OP_TYPE_ACCELERATION_STRUCTURE))

# Constants, and those that a pipeline may give other values (specialization constants).
OP_CONSTANT_TRUE = 41
OP_CONSTANT_FALSE = 42
OP_CONSTANT = 43
OP_SPEC_CONSTANT_TRUE = 48
OP_SPEC_CONSTANT_FALSE = 49
OP_SPEC_CONSTANT = 50
OP_SPEC_CONSTANT_OP = 52  # computed of others by an opcode that is its third operand

# Functions and variables. Function calls name the function behind their result.
OP_FUNCTION = 54
OP_FUNCTION_PARAMETER = 55
OP_FUNCTION_END = 56
OP_FUNCTION_CALL = 57
OP_VARIABLE = 59
STORAGE_UNIFORM_CONSTANT = 0  # images, samplers and acceleration structures
STORAGE_UNIFORM = 2
STORAGE_PUSH_CONSTANT = 9
STORAGE_BUFFER = 12
STORAGE_SHADER_RECORD = 5343
STORAGE_PHYSICAL = 5349  # memory by address: buffer_reference
RESOURCE_STORAGE = (STORAGE_UNIFORM_CONSTANT, STORAGE_UNIFORM, STORAGE_BUFFER)

# Memory. Access chains make a pointer to a part of what a pointer leads to.
OP_IMAGE_TEXEL_POINTER = 60
OP_LOAD = 61
OP_STORE = 62
OP_COPY_MEMORY = 63
OP_COPY_MEMORY_SIZED = 64
OP_ACCESS_CHAIN = 65
OP_IN_BOUNDS_ACCESS_CHAIN = 66
OP_PTR_ACCESS_CHAIN = 67
OP_ARRAY_LENGTH = 68
OP_IN_BOUNDS_PTR_ACCESS_CHAIN = 70
MEMORY_ALIGNED = 2  # in the mask of memory operands: an alignment in bytes follows
ACCESS_CHAINS = (OP_ACCESS_CHAIN, OP_IN_BOUNDS_ACCESS_CHAIN, OP_PTR_ACCESS_CHAIN, OP_IN_BOUNDS_PTR_ACCESS_CHAIN)

# Values.
OP_VECTOR_EXTRACT_DYNAMIC = 77
OP_COPY_OBJECT = 83
OP_SAMPLED_IMAGE = 86
OP_IMAGE_WRITE = 99
OP_IMAGE = 100
OP_CONVERT_U_TO_PTR = 117
OP_BITCAST = 124
OP_LOGICAL_EQUAL = 164
OP_LOGICAL_NOT_EQUAL = 165
OP_LOGICAL_OR = 166
OP_LOGICAL_AND = 167
OP_LOGICAL_NOT = 168
OP_SELECT = 169
OP_I_EQUAL = 170
OP_I_NOT_EQUAL = 171
OP_ATOMIC_LOAD = 227
OP_ATOMIC_STORE = 228
OP_ATOMIC_FLAG_CLEAR = 319
OP_TRACE_RAY = 4445
OP_RAY_QUERY_INITIALIZE = 4473

# Control flow. A merge instruction stands before the branch that ends a block: it names the block in which the paths of
# a selection or a loop meet again, and the one from which a loop goes back to its head. A phi chooses by predecessor.
OP_PHI = 245
OP_LOOP_MERGE = 246
OP_SELECTION_MERGE = 247
OP_LABEL = 248
OP_BRANCH = 249
OP_BRANCH_CONDITIONAL = 250
OP_SWITCH = 251
OP_RETURN_VALUE = 254
OP_UNREACHABLE = 255


def opcode(words: Words) -> int:
    """The opcode of an instruction."""
    return words[0] & 0xFFFF


def encoded(op: int, *operands: int) -> Words:
    """The words of an instruction."""
    return [(len(operands) + 1) << 16 | op, *operands]


def instructions(spirv: bytes) -> Iterator[Words]:
    """The words of each instruction of a module."""
    words = np.frombuffer(spirv, np.uint32).tolist()
    at = HEADER_WORDS
    while at < len(words):
        end = at + (words[at] >> 16)
        yield words[at:end]
        at = end


def text(words: Words) -> str:
    """The string that starts at the first of these words."""
    return np.array(words, np.uint32).tobytes().split(b"\0", 1)[0].decode(errors="replace")
