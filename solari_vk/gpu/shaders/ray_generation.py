"""Compute shaders as ray generation shaders, for devices that trace rays by pipelines.

A shader that traces rays is one whose module has ray queries in the code that it reaches. It is compiled a second time
with RAY_PIPELINES defined, which makes scene/trace.glsl trace by a ray pipeline. The number of threads of such a shader
is given when it is launched, so its declaration of a local size is removed.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

DEFINE = "RAY_PIPELINES"
TRACE = "scene/trace.glsl"
HINT = (
    "it traces rays, so that a device that traces by pipelines runs it as a ray generation shader: read the index of "
    "the invocation from INVOCATION_INDEX, declare the local size in the shader's own file, and use no shared memory "
    "and no barrier"
)
OWN_QUERIES = (
    "it has ray queries of its own, which need a device with VK_KHR_ray_query, opened with rays='query'; "
    f"shaders that trace by {TRACE} run on any device"
)
_LOCAL_SIZE = re.compile(r"\blayout\s*\([^()]*\blocal_size_[^()]*\)\s*in\s*;")
_OP_CAPABILITY, _CAPABILITY_RAY_QUERY = 17, 4472


def without_local_size(source: str) -> str:
    """The text of a compute shader without its local size; its lines keep their numbers."""
    return _LOCAL_SIZE.sub(lambda found: "\n" * found[0].count("\n"), source)


def instructions(spirv: bytes) -> Iterator[list[int]]:
    """The words of each instruction; the first holds the length above 16 bits of opcode."""
    words, at = np.frombuffer(spirv, np.uint32).tolist(), 5
    while at < len(words):
        start, at = at, at + (words[at] >> 16)
        yield words[start:at]


def uses_ray_queries(spirv: bytes) -> bool:
    """Whether a module declares the capability of ray queries."""
    return any(words[1] == _CAPABILITY_RAY_QUERY for words in _preamble(spirv))


def _preamble(spirv: bytes) -> Iterator[list[int]]:
    """The capabilities, with which a module begins."""
    for words in instructions(spirv):
        if words[0] & 0xFFFF != _OP_CAPABILITY:
            return
        yield words
