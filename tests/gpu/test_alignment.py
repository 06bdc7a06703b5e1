"""Loads and stores by address are aligned to the largest scalar of what they move, which older validators don't check:
VUID-StandaloneSpirv-PhysicalStorageBuffer64-06314."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

from solari_vk.base.errors import CompilationError
from solari_vk.gpu.shaders import compiler
from solari_vk.gpu.shaders.compiler import compile_shader
from tests.gpu.shader_folder import ShaderFolder, check_spirv

GLSL = Path(__file__).resolve().parents[2] / "glsl"

TYPE = re.compile(r"(%\S+) = OpType(\w+) ?(.*)")
ACCESS = re.compile(r"(?:= OpLoad (%\S+) \S+|OpStore \S+ (%\S+)) Aligned (\d+)")
UNALIGNED = """#extension GL_EXT_buffer_reference : require
layout(local_size_x = 1) in;
layout(buffer_reference, scalar, buffer_reference_align = 4) buffer Numbers { uint at[]; };
struct Row { Numbers numbers; uint count; };
layout(buffer_reference, scalar, buffer_reference_align = ALIGNMENT) readonly buffer Rows { Row at[]; };
layout(push_constant) uniform Work { Rows rows; } work;
void main() { Row row = work.rows.at[1]; row.numbers.at[0] = row.count; }
"""


def too_small(spirv):
    """The accesses whose alignment is less than the largest scalar of their type."""
    command = ["spirv-dis", "--no-color", "-"]
    text = subprocess.run(command, input=spirv, capture_output=True, check=True).stdout.decode()
    types = {name: (kind, rest.split()) for name, kind, rest in TYPE.findall(text)}
    values = dict(re.findall(r"(%\S+) = Op\w+ (%\S+)", text))

    def largest(name):
        kind, operands = types[name]
        if kind == "Pointer":
            return 8
        if kind in ("Int", "Float"):
            return int(operands[0]) // 8
        return max([largest(inner) for inner in operands if inner in types], default=4)

    for line in text.splitlines():
        found = ACCESS.search(line)
        if found:
            name = found[1] or values[found[2]]
            if int(found[3]) < largest(name):
                yield line.strip()


@pytest.mark.parametrize("path", ["scene/deform.comp", "passes/viewer/overlay.vert", "passes/reference/start.comp"])
def test_accesses_by_address_are_aligned(path):
    assert not list(too_small(compile_shader(path)))


@pytest.mark.parametrize("alignment", [4, 8])
def test_a_small_alignment_is_noticed(tmp_path, alignment):
    ShaderFolder(tmp_path).write("demo", UNALIGNED.replace("ALIGNMENT", str(alignment)))
    try:
        noticed = any(too_small(compile_shader("passes/demo.comp", root=tmp_path)))
    except CompilationError as error:  # by compilers of 2026
        noticed = "PhysicalStorageBuffer64-06314" in str(error)
    assert noticed == (alignment < 8)


@pytest.mark.slow
def test_every_shipped_module_is_valid(tmp_path):
    """Both ways to trace, with and without features; by the validator that SPIRV_VAL names."""
    compiler.build_all(GLSL, tmp_path)
    modules = sorted(tmp_path.rglob("*.spv"))
    assert len(modules) > 150
    for module in modules:
        check_spirv(module.read_bytes(), module.name)
