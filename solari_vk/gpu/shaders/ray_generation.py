"""Compute shaders as ray generation shaders, for devices that trace rays by pipelines.

A shader that traces rays is one whose module has ray queries in the code that it reaches. It is compiled a second time
with RAY_PIPELINES defined, which makes scene/trace.glsl trace by a ray pipeline. The number of threads of such a shader
is given when it is launched, so its declaration of a local size is removed.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from solari_vk.gpu.shaders import spv

DEFINE = "RAY_PIPELINES"
DEFINES = {"pipeline": DEFINE, "compute": "RAYS_BY_COMPUTE"}
"""What is defined in the modules of shaders that trace rays otherwise than by queries, by the method."""
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


def without_local_size(source: str) -> str:
    """The text of a compute shader without its local size; its lines keep their numbers."""
    # Line breaks inside the declaration stay, so that errors name the right lines.
    return _LOCAL_SIZE.sub(lambda found: "\n" * found[0].count("\n"), source)


def uses_ray_queries(spirv: bytes) -> bool:
    """Whether a module declares the capability of ray queries."""
    return any(words[1] == spv.CAPABILITY_RAY_QUERY for words in _preamble(spirv))


def _preamble(spirv: bytes) -> Iterator[list[int]]:
    """The capabilities, with which a module begins."""
    for words in spv.instructions(spirv):
        if spv.opcode(words) != spv.OP_CAPABILITY:
            return
        yield words
